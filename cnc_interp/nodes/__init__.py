"""ROS 2 nodes: thin layers around packages that do not use ROS."""
