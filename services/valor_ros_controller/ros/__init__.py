"""The ROS 2 side: action servers, topics and what they turn into for the controllers, which know no ROS."""
