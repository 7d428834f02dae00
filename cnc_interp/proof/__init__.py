"""Plan files and their proof. The proof shares only the forward kinematics with the planner."""
