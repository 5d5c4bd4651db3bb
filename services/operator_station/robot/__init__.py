"""State of the robot, as received over ROS 2."""
