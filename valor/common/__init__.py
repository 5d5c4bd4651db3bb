"""What everything else stands on: messages, topics, processes, the instance, files and tables.

Free of ROS: the Motion System imports it.
"""
