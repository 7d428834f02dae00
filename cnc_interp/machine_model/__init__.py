"""The model of the machine: its file, axes, drives and kinematics."""
