"""Session between the two ends: a handshake with fresh numbers of both, sealed datagrams, rejection of duplicates.

The handshake is AKEP2 (M. Bellare and P. Rogaway, "Entity Authentication and Key Distribution", 1993) with the secret
of both ends' Bifrost keys (Curve25519). ``o`` and ``r`` are numbers drawn by the operator's and the robot's end:

1. Operator: ``0``, o (16), fingerprint (8), mark (16): keyed BLAKE2b of the rest.
2. Robot: ``2``, o, r (16), its fingerprint, mark.
3. Operator: ``3``, o, tag (8): the first datagram under the session's keys, HKDF-SHA256 of the secret, o and r.

The robot's end starts the session with 3, the operator's with the first datagram under its keys. Either number is used
for one session only. Datagrams are sealed with AES-256-CCM and a short tag of 8 bytes (CCM_8 of RFC 6655), and their
counter is the nonce: ``1``, counter (4), sealed records and tag (8).
"""

import hashlib
import hmac
import secrets
import struct

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import AESCCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from zmq.utils import z85

from valor.link.errors import SealError

HELLO, SEALED, ANSWER, CONFIRMATION = 0, 1, 2, 3
NUMBER, FINGERPRINT, MARK = 16, 8, 16
SEAL = 8  # tag of a sealed datagram [B]
_HEADER = struct.Struct(">BI")
OVERHEAD = _HEADER.size + SEAL
"""Bytes of a sealed datagram in addition to its records [B]."""
WINDOW = 1024  # counters behind the highest that are accepted
CANDIDATES = 8  # sessions that the robot's end may have started


def shared_secret(own_secret: bytes, other_public: bytes) -> bytes:
    """(32,) secret that only the owners of the two key pairs can compute; keys in Z85, like Bifrost's."""
    private = X25519PrivateKey.from_private_bytes(z85.decode(own_secret))
    return private.exchange(X25519PublicKey.from_public_bytes(z85.decode(other_public)))


def fingerprint(*contents: bytes) -> bytes:
    """(8,) digest of files and tables that must be equal at both ends."""
    digest = hashlib.blake2b(digest_size=FINGERPRINT)
    for content in contents:
        digest.update(len(content).to_bytes(8, "big") + content)
    return digest.digest()


class _Keys:
    """Keys and counters of one session at one end; counter 0 is the confirmation's."""

    def __init__(self, down: bytes, up: bytes, robot_end: bool) -> None:
        self._sending, self._receiving = (AESCCM(key, SEAL) for key in ((down, up) if robot_end else (up, down)))
        self.counter, self._highest = 0, -1
        self._seen: set[int] = set()

    def confirmation(self, header: bytes) -> bytes:
        return header + self._sending.encrypt(_nonce(0), b"", header)

    def confirms(self, data: bytes) -> bool:
        return self._decrypted(0, data[-SEAL:], data[:-SEAL]) is not None

    def seal(self, records: bytes) -> bytes:
        self.counter += 1
        header = _HEADER.pack(SEALED, self.counter)  # raises before a counter is used again
        return header + self._sending.encrypt(_nonce(self.counter), records, header)

    def open(self, data: bytes) -> tuple[bytes, int] | None:
        """Records and counter; None if not of this session, corrupted, too old or received before."""
        header, counter = data[: _HEADER.size], _HEADER.unpack_from(data)[1]
        if not counter or counter in self._seen or counter <= self._highest - WINDOW:
            return None
        if (records := self._decrypted(counter, data[_HEADER.size :], header)) is None:
            return None
        self._seen.add(counter)
        self._highest = max(self._highest, counter)
        if len(self._seen) > 2 * WINDOW:
            self._seen = {each for each in self._seen if each > self._highest - WINDOW}
        return records, counter

    def _decrypted(self, counter: int, sealed: bytes, header: bytes) -> bytes | None:
        try:
            return self._receiving.decrypt(_nonce(counter), sealed, header)
        except InvalidTag:
            return None


class Session:
    """One end of the session."""

    def __init__(self, secret: bytes, robot_end: bool, print_: bytes) -> None:
        """``secret``: shared with the other end; ``print_``: fingerprint that the other end must have, too."""
        self._secret, self._robot_end, self._print = secret, robot_end, print_
        self._mark_key = self._derived(b"", b"handshake", 32)
        self._own = secrets.token_bytes(NUMBER)
        self._asks = False  # whether the operator's end expects an answer
        self._keys: _Keys | None = None
        self._candidates: list[_Keys] = []  # of the operator's end: answered, no datagram received yet
        self._confirmation = b""  # of the latest candidate
        self.number = 0  # of sessions so far; a change means that pending messages are lost
        self.mismatch = ""  # reason for which the other end is rejected; empty if it is not

    @property
    def established(self) -> bool:
        """Whether datagrams can be sealed and opened."""
        return self._keys is not None

    def requests(self) -> list[bytes]:
        """Datagrams of the operator's end that request a session; none at the robot's end."""
        if self._robot_end:
            return []
        if not self._asks:
            self._asks, self._own = True, secrets.token_bytes(NUMBER)
        hello = self._marked(bytes((HELLO,)) + self._own + self._print)
        return [self._confirmation, hello] if self._confirmation else [hello]

    def receive(self, data: bytes) -> bytes:
        """Process a datagram of the handshake; returns the reply, empty if there is none.

        Raises SealError: not from the other end, of another robot, or of an earlier handshake.
        """
        kind = data[:1]
        if self._robot_end and kind == bytes((HELLO,)):
            (operators,) = self._checked(data, 1)
            return self._marked(bytes((ANSWER,)) + operators + self._own + self._print)
        if self._robot_end and kind == bytes((CONFIRMATION,)) and len(data) == 1 + NUMBER + SEAL:
            keys = self._session_keys(data[1 : 1 + NUMBER], self._own)
            if not keys.confirms(data):
                raise SealError("confirmation of another session")
            self._own = secrets.token_bytes(NUMBER)
            self._start(keys)
            return b""
        if not self._robot_end and kind == bytes((ANSWER,)):
            return self._answered(data)
        raise SealError("not a datagram of the other end")

    def _answered(self, data: bytes) -> bytes:
        if not self._asks or data[1 : 1 + NUMBER] != self._own:
            raise SealError("answer to an earlier hello")
        own, robots = self._checked(data, 2)
        if self.mismatch:
            raise SealError(self.mismatch)
        self._own = secrets.token_bytes(NUMBER)
        keys = self._session_keys(own, robots)
        self._candidates = [*self._candidates[1 - CANDIDATES :], keys]
        self._confirmation = keys.confirmation(bytes((CONFIRMATION,)) + own)
        return b"" if self.established else self._confirmation  # a silent session may continue until the next request

    def _checked(self, data: bytes, numbers: int) -> list[bytes]:
        """Numbers of a hello or answer; sets ``mismatch``."""
        size = 1 + numbers * NUMBER
        if len(data) != size + FINGERPRINT + MARK or not hmac.compare_digest(data, self._marked(data[:-MARK])):
            raise SealError("a hello with another key, or of another version")
        equal = data[size:-MARK] == self._print
        self.mismatch = "" if equal else "the other end has another version, or other files of the robot"
        return [data[at : at + NUMBER] for at in range(1, size, NUMBER)]

    def _marked(self, body: bytes) -> bytes:
        return body + hashlib.blake2b(body, key=self._mark_key, digest_size=MARK).digest()

    def _session_keys(self, operators: bytes, robots: bytes) -> _Keys:
        both = self._derived(operators + robots, b"session", 64)
        return _Keys(both[:32], both[32:], self._robot_end)

    def _derived(self, salt: bytes, info: bytes, length: int) -> bytes:
        return HKDF(SHA256(), length, salt, b"valor link " + info).derive(self._secret)

    def _start(self, keys: _Keys) -> None:
        self._keys, self._candidates, self._confirmation = keys, [], b""
        self.number += 1

    @property
    def next_counter(self) -> int:
        """Counter of the next sealed datagram."""
        return self._keys.counter + 1 if self._keys else 0

    def seal(self, records: bytes) -> bytes:
        """Sealed datagram. Raises SealError: no session."""
        if self._keys is None:
            raise SealError("no session")
        return self._keys.seal(records)

    def open(self, data: bytes) -> tuple[bytes, int]:
        """Records of a sealed datagram, and its counter; the first one of a new session starts it.

        Raises SealError: not of this session, corrupted, too old or received before.
        """
        if len(data) < OVERHEAD:
            raise SealError("datagram too short")
        for keys in (self._keys, *self._candidates):
            if keys is not None and (opened := keys.open(data)) is not None:
                if keys is not self._keys:
                    self._start(keys)
                self._asks, self.mismatch = False, ""
                return opened
        raise SealError("datagram of another session, corrupted, too old or received before")


def _nonce(counter: int) -> bytes:
    return counter.to_bytes(12, "big")
