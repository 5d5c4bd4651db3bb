"""The robot's end of the link: tells its state, obeys what comes in time. To the robot it is a client like others."""
