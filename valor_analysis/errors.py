"""What this package raises. Every text is one line."""

from valor_common.errors import ValorError


class BagError(ValorError):
    """A bag is missing, broken, or lacks what is asked of it: names the file and the topic."""


class RenderingError(ValorError):
    """This computer cannot render off screen: names what to install."""
