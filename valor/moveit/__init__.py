"""A robot's configuration for MoveIt, out of its folder."""
