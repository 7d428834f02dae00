"""The machine: its states, drives and travel limits. This room needs no ROS."""
