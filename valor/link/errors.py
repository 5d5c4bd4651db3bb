"""Errors of the link."""

from valor.common.errors import ValorError


class LinkError(ValorError):
    """Base class."""


class CodecError(LinkError):
    """A state that this table's encoder has not made, or whose reference frame is missing."""


class SealError(LinkError):
    """A datagram of another session, malformed or received before; or a message that cannot be sent."""
