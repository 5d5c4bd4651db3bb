"""The operator's end of the link: the robot's public interfaces in the operator's ROS domain, and how old all is."""
