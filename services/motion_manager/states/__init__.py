"""Behaviors: the state machines as tables, and who walks them."""
