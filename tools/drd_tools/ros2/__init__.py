"""drd's output for ROS 2 with any middleware: a node between Zenoh and rclpy."""
