"""Search for the motions by which a robot gets up, in simulation: ``valorctl robot get-up`` makes ``get_up.yaml``."""
