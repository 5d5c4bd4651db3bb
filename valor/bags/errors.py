"""Errors about bags. Every message is one line."""

from valor.common.errors import ValorError


class BagError(ValorError):
    """A file is not a bag, cannot be read or recovered, or lacks requested data."""
