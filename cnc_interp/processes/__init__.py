"""Start and end the processes of cnc_interp; restrict ROS to this computer."""
