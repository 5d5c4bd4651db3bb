"""Setting up, starting, supervising and stopping an instance."""
