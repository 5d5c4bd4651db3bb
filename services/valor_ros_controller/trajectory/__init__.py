"""Joint trajectories: checked way-points, and splines through them.

The meaning is that of ros2_controllers' ``joint_trajectory_controller`` (Jazzy): between two points that both carry
velocities the path is cubic, with accelerations quintic, else linear; before the first point it comes from where the
robot was told to be. What is stricter here: every number is finite, every point and every point of the splines lies
within the joints' limits, and no trajectory begins with a jump. No input or output in this package.

::

    errors, splines, waypoints, execution ◄── admission        tolerances
"""
