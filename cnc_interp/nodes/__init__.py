"""ROS 2 nodes: thin layers around the rooms without ROS."""
