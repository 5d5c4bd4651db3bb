"""What this package raises. Every text is one line."""

from valor.common.errors import ValorError

OFFSCREEN = ("libegl1", "libgl1-mesa-dri", "libopengl0")
"""What Debian and Ubuntu call that by which pictures are drawn off screen."""


class RenderingError(ValorError):
    """This computer cannot render off screen: names what to install."""
