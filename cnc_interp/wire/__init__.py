"""Dataclasses to ROS messages and back, their checks, and the window protocol."""
