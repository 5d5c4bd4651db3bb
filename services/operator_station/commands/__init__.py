"""Commands: who may give them, and how they are sent."""
