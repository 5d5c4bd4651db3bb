"""Joints: where each shall be, and how stiffly it is driven."""
