"""State, health and logs of a running instance."""
