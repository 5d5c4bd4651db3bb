"""Bags into numbers and pictures. Knows messages and the robot's description, nothing of the services."""
