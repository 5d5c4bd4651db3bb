"""Analysis of the experiments' recordings."""
