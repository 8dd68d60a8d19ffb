"""The node of eagor for ROS 2 with rclpy."""
