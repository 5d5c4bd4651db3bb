"""Joints: references, gains and servo compensation."""
