"""Verbs about trained policies."""
