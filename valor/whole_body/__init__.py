"""Whole-Body Controller: estimate, balance, walk, fall detection (thesis 3.4.2; docs/whole_body_controller.md)."""
