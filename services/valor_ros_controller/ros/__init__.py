"""ROS 2 interfaces of the controllers."""
