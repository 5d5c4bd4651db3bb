"""The stop button of the operator's page: a page of its own, and a way of its own to the robot."""
