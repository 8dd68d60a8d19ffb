"""ROS 2: one node on rclpy."""
