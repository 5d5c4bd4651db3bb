"""How the robot carries itself: who has the joints in each state of the Locomotion FSM."""
