"""Conversion of dataclasses to ROS messages and back, message checks, and the window protocol."""
