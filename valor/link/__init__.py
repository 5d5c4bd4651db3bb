"""Link between the robot's network and the operator's; ROS is in ``services/link_robot`` and ``link_operator``."""
