"""Verbs on robots' folders: make, check, show, export."""
