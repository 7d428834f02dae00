"""Plan files and their proof; shares only the forward kinematics with the planner."""
