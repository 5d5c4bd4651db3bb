"""The link of the robot's network and the operator's: tiny states, commands that are never late, a bad link emulated.

Nothing here knows ROS: ``services/link_robot`` and ``services/link_operator`` do.
"""
