"""Hands: contacts, loads and Cartesian goals."""
