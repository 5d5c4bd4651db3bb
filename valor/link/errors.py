"""What goes wrong on a link. One line each."""

from valor.common.errors import ValorError


class LinkError(ValorError):
    """Base of what the link raises."""


class CodecError(LinkError):
    """Bytes that no encoder of this table made, or whose reference frame is not here."""


class SealError(LinkError):
    """A datagram that is not of this session, not whole, or has been here before."""


class BulkError(LinkError):
    """A thing of the fast channel that cannot be had, or kept; says which and why."""
