"""Bags as numbers and pictures. Depends on messages and the robot's description, not on the services."""
