"""Floating-base estimator and its parts."""
