"""What keeps the robot safe whatever is asked: whose it is, whether it stands, what its devices demand."""
