"""What everything else stands on: messages, topics, processes, instances, files, tables. Never imports ROS."""
