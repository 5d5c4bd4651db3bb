"""A session between the two ends: who the other one is, sealed datagrams, and none taken twice.

Both ends have a key pair (Curve25519, Bifrost's). Each says hello with a number of its own, drawn when it starts; when
both numbers are known to be fresh, a key each way follows from them. So nothing that was sent before either end
started can be opened. Datagrams are sealed with AES-256-CCM with a tag of 8 bytes, as where every byte counts (CCM_8 of
RFC 6655); their counter is the nonce. What must not push others out of the window of counters has keys and counters of
its own, of ChaCha20-Poly1305 (RFC 8439, ``keys``).

On the wire: ``0`` for a hello that asks for one or ``2`` for an answer, the sender's number (16), the other end's as
the sender knows it (16), fingerprint (8), BLAKE2b of these (16); or ``1``, counter (4), sealed records and tag (8).
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import struct
from dataclasses import dataclass, field

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import AESCCM, ChaCha20Poly1305
from zmq.utils import z85

from valor.link.errors import SealError

ASKS, SEALED, ANSWERS = 0, 1, 2
NUMBER, FINGERPRINT, TAG = 16, 8, 16
SEAL = 8  # of a sealed datagram's tag [B]
_HEADER = struct.Struct(">BI")
OVERHEAD = _HEADER.size + SEAL
"""Of a sealed datagram beside its records [B]."""
WINDOW = 1024  # counters behind the highest that may still come


def shared_secret(own_secret: bytes, other_public: bytes) -> bytes:
    """(32,) what the owners of two key pairs alone can know; keys in Z85, as Bifrost has them."""
    private = X25519PrivateKey.from_private_bytes(z85.decode(own_secret))
    return private.exchange(X25519PublicKey.from_public_bytes(z85.decode(other_public)))


def fingerprint(*contents: bytes) -> bytes:
    """(8,) by which both ends see that they speak of the same robot in the same words."""
    digest = hashlib.blake2b(digest_size=FINGERPRINT)
    for content in contents:
        digest.update(len(content).to_bytes(8, "big") + content)
    return digest.digest()


@dataclass
class _Keys:
    """Of one session, as one end has them."""

    sending: AESCCM
    receiving: AESCCM
    counter: int = 0
    highest: int = -1
    seen: set[int] = field(default_factory=set)


class Session:
    """One end of it.

    Attributes:
        established: whether datagrams can be sealed and opened.
        number: how many sessions there have been; whoever sees it change has lost all that was under way.
        strange: why the other end's hello was not accepted; empty: it was, or there was none.
    """

    def __init__(self, secret: bytes, robot_end: bool, print_: bytes) -> None:
        """Begin.

        Args:
            secret: shared with the other end.
            robot_end: which end this is.
            print_: what must be the same at the other end.
        """
        self._secret, self._robot_end, self._print = secret, robot_end, print_
        self._own, self._other = secrets.token_bytes(NUMBER), bytes(NUMBER)
        self._keys: _Keys | None = None
        self._begun: tuple[bytes, bytes] | None = None  # both ends' numbers, the robot's first
        self.number = 0
        self.strange = ""

    @property
    def established(self) -> bool:
        """Whether both ends' numbers are known to be fresh."""
        return self._keys is not None

    def hello(self, asks: bool) -> bytes:
        """What to send while the other end is not heard (it ``asks`` for an answer), and in answer."""
        body = bytes((ASKS if asks else ANSWERS,)) + self._own + self._other + self._print
        return body + self._mark(body)

    def _mark(self, body: bytes) -> bytes:
        robot = self._robot_end == (body[1 : 1 + NUMBER] == self._own)
        return hashlib.blake2b((b"robot" if robot else b"operator") + body, key=self._secret, digest_size=TAG).digest()

    def hear(self, data: bytes) -> bool:
        """A hello; whether to answer it with one.

        Raises:
            SealError: it is not from the other end, or of another robot.
        """
        body, mark = data[:-TAG], data[-TAG:]
        if len(data) != 1 + 2 * NUMBER + FINGERPRINT + TAG or not hmac.compare_digest(self._mark(body), mark):
            raise SealError("a hello that the other end has not made")
        other, known = body[1 : 1 + NUMBER], body[1 + NUMBER : 1 + 2 * NUMBER]
        if other == self._own:
            raise SealError("a hello of one's own")
        if body[-FINGERPRINT:] != self._print:
            self.strange = "the other end has another version, or other files of the robot"
            raise SealError(self.strange)
        self.strange = ""
        if known == self._own and (other != self._other or self._keys is None):  # fresh: of this process
            self._other = other
            self._keys = self._derive()
            self.number += 1
        elif self._keys is None:
            self._other = other
        # While somebody begins anew a session goes on, until their next hello shows that they know this end's number.
        return data[0] == ASKS

    def _derive(self) -> _Keys:
        self._begun = (self._own, self._other) if self._robot_end else (self._other, self._own)
        down, up = (AESCCM(each, SEAL) for each in self._secrets(b""))
        return _Keys(down, up) if self._robot_end else _Keys(up, down)

    def keys(self, purpose: bytes) -> tuple[ChaCha20Poly1305, ChaCha20Poly1305]:
        """To send by and to receive by, of this session and for one purpose (at most 16 bytes) alone.

        Raises:
            SealError: there is no session.
        """
        down, up = map(ChaCha20Poly1305, self._secrets(purpose))
        return (down, up) if self._robot_end else (up, down)

    def _secrets(self, purpose: bytes) -> tuple[bytes, bytes]:
        """From the robot, and to it."""
        if self._begun is None:
            raise SealError("no session")
        robot, operator = self._begun
        both = hashlib.blake2b(robot + operator, key=self._secret, digest_size=64, person=purpose).digest()
        return both[:32], both[32:]

    @property
    def next_counter(self) -> int:
        """Of the datagram that is sealed next."""
        return self._keys.counter + 1 if self._keys else 0

    def seal(self, records: bytes) -> bytes:
        """A datagram.

        Raises:
            SealError: there is no session.
        """
        keys = self._keys
        if keys is None:
            raise SealError("no session")
        keys.counter += 1
        header = _HEADER.pack(SEALED, keys.counter)
        sealed = keys.sending.encrypt(_nonce(keys.counter), records, header)
        return header + sealed

    def open(self, data: bytes) -> tuple[bytes, int]:
        """The records of a sealed datagram, and its counter.

        Raises:
            SealError: it is not of this session, not whole, or has been here before.
        """
        keys = self._keys
        if keys is None or len(data) < OVERHEAD:
            raise SealError("no session" if keys is None else "a datagram too short")
        header = data[: _HEADER.size]
        counter = _HEADER.unpack(header)[1]
        if counter in keys.seen or counter <= keys.highest - WINDOW:
            raise SealError("a datagram that has been here before, or is too old to know")
        try:
            records = keys.receiving.decrypt(_nonce(counter), data[_HEADER.size :], header)
        except InvalidTag:
            raise SealError("a datagram of another session, or not whole") from None
        keys.seen.add(counter)
        keys.highest = max(keys.highest, counter)
        if len(keys.seen) > 2 * WINDOW:
            keys.seen = {each for each in keys.seen if each > keys.highest - WINDOW}
        return records, counter


def _nonce(counter: int) -> bytes:
    return counter.to_bytes(12, "big")
