"""What the services share: messages, topics, processes, the robot description, the instance and the clock.

Free of ROS: the Motion System imports it.
"""
