"""Where the robot is: the floating-base estimator and its parts."""
