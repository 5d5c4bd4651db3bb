"""Robot's end of the link, a ROS 2 client: sends the state, executes commands received in time."""
