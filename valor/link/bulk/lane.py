"""Datagrams of the fast channel that are no part of the slow one's session: keys and counters of their own.

On the wire: ``3``, counter (8), sealed content and tag (16).
"""

from __future__ import annotations

import struct

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from valor.link.errors import SealError
from valor.link.session import TAG, Session

BULK = 3  # first byte; the session's are 0 to 2
_HEADER = struct.Struct(">BQ")
OVERHEAD = _HEADER.size + TAG
"""Of a datagram beside its content [B]."""
_PURPOSE = b"bulk"


class Lane:
    """Seals and opens with keys that follow from a session, anew when that begins anew.

    Attributes:
        session: both ends'.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self._number = 0
        self._counter = 0
        self._sending: ChaCha20Poly1305 | None = None
        self._receiving: ChaCha20Poly1305 | None = None

    def renewed(self) -> bool:
        """Take the keys of the session that is; whether it is another than at the last call."""
        if self.session.number == self._number:
            return False
        self._number, self._counter = self.session.number, 0
        self._sending, self._receiving = self.session.keys(_PURPOSE)
        return True

    def seal(self, content: bytes) -> bytes:
        """A datagram.

        Raises:
            SealError: there is no session.
        """
        if self._sending is None:
            raise SealError("no session")
        self._counter += 1
        header = _HEADER.pack(BULK, self._counter)
        return header + self._sending.encrypt(bytes(4) + header[1:], content, header)

    def open(self, data: bytes) -> tuple[bytes, int]:
        """The content of a datagram, and its counter: one that was here before is not refused.

        Raises:
            SealError: it is not of this session, or not whole.
        """
        if self._receiving is None or len(data) < OVERHEAD:
            raise SealError("no session" if self._receiving is None else "a datagram too short")
        header = data[: _HEADER.size]
        try:
            content = self._receiving.decrypt(bytes(4) + header[1:], data[_HEADER.size :], header)
        except InvalidTag:
            raise SealError("a datagram of another session, or not whole") from None
        return content, _HEADER.unpack(header)[1]
