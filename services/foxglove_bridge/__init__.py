"""Foxglove bridge: an instance's ROS 2 topics, and a scene made of them, by WebSocket."""
