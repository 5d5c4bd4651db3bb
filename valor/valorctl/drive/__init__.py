"""Verbs that drive a running robot: modes, limbs, steps, walks, stops."""
