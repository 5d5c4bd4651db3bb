"""What goes wrong with a bag. Every text is one line."""

from valor.common.errors import ValorError


class BagError(ValorError):
    """A file is no bag, cannot be read or recovered, or lacks what is asked of it: names it, and what is wrong."""
