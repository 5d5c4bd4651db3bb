"""Driver of the HDT arms and hands: a ROS 2 node between topics and the modules' bus, without Bifrost."""
