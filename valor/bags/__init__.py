"""Bags, which the recorder writes and the tools read: their files, and all recordings of an instance. Free of ROS."""
