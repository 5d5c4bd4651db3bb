"""Films of a robot from a bag."""
