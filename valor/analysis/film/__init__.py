"""Films of a robot: what a bag says, drawn picture by picture."""
