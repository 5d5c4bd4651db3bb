"""Joint trajectories: checked way-points, and splines through them. Without input and output.

The semantics are those of ros2_controllers' ``joint_trajectory_controller`` (Jazzy): between two points the path is
cubic if both have velocities, quintic if both have accelerations too, else linear; the first segment begins at the
set-point. In addition every number is finite, points and splines lie within the joints' limits, and no trajectory
begins with a jump.
"""
