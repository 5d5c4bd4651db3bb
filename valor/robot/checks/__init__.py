"""Checks of a robot's folder; ``folder.py`` has the table of all of them."""
