"""ROS 2 nodes: thin glue around the pure rooms; the only place that knows rclpy."""
