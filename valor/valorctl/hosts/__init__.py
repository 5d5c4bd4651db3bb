"""An instance on several computers: who they are, an agent on each, and what is done on all of them together."""
