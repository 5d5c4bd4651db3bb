"""The bridge between the Comms Manager's HDT topics on Bifrost and those of the HDT driver on ROS 2."""
