"""Simulated head camera: pictures on ROS 2 while subscribed."""
