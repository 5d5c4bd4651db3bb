"""Handlers of commands and requests, one module for each topic."""
