"""The machine: its file, axes and drives, and its kinematics."""
