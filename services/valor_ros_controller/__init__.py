"""The Valor ROS Controller: control modes, trajectory controllers and robot state on ROS 2 (thesis, chapter 4)."""
