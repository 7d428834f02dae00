"""Convert dataclasses to ROS messages and back; check messages; the window protocol."""
