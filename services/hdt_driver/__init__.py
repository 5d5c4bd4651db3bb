"""The vendor's driver of the HDT arms and hands: a ROS 2 node before the modules' bus. It knows nothing of Bifrost."""
