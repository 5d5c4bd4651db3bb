"""ROS parts shared by processes: node, life cycle, log, parameters, message types and QoS."""
