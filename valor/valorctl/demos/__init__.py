"""Demonstrations: a system of their own, a bag, pictures."""
