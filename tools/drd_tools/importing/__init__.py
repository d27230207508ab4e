"""Import of other systems' recordings (ROS bags, CAN logs, tables) into the neutral recording folder."""
