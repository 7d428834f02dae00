"""Plan files and their proof, which shares only machine file and kinematics with the planner."""
