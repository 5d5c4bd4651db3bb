"""A soak: a real robot does what it is commanded while everything around it is killed, stopped, flooded and lied to."""
