"""Hands: what they touch, and Cartesian goals that lead them."""
