"""The controllers that the three managers run, and their ROS faces."""
