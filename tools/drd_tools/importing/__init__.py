"""Recordings of other systems (ROS bags, CAN logs, tables) into the neutral recording folder."""
