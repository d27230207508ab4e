"""drd's output for ROS 2 through whatever middleware ROS 2 uses: a node between Zenoh and rclpy."""
