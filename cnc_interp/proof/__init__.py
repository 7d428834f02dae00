"""Plan files and their proof, which shares machine files and kinematics with the planner."""
