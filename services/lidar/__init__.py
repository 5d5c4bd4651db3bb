"""Simulated rolling lidar: scans and clouds on ROS 2 while subscribed."""
