"""The camera in a simulated robot's head: pictures on ROS 2, while somebody looks."""
