"""The simulated machine: states, drives, soft limits; no clock, no ROS."""
