"""Bags as arrays, in the robot's terms, and as CSV or Parquet."""
