"""What the ROS side's processes share: node, life, log, parameters; types by their names, and the QoS that suits."""
