"""Plots and pictures of the robot: tracking, balance, before and after, calibration."""
