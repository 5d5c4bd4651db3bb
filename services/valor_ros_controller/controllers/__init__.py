"""Controllers of the three managers."""
