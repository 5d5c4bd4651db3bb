"""Metrics, plots and footprints of a walk."""
