"""The bytes in front of every payload. ``docs/bifrost.md`` is the specification; this is its one implementation.

All numbers are little-endian and unaligned.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path
from struct import Struct

VERSION = 1
MAX_MESSAGE_SIZE = 64 * 2**20  # [B]; a peer that sends more is disconnected

# A published message is one frame: topic, NUL, PUBLICATION, origin, payload.
# version, schema hash, incarnation of the publisher, sequence, monotonic stamp [ns], length of origin [B]
PUBLICATION = Struct("<B8sQQqB")
PUBLICATION_CONSTANT = Struct("<B8sQ")
PUBLICATION_VARIABLE = Struct("<Qq")
# A latched publisher's last message, sent to one late subscriber alone, has this byte between the NUL and PUBLICATION.
LATCHED = b"\xff"

# A request is one frame: topic, NUL, REQUEST, origin, payload.
# version, request's schema hash, reply's schema hash, request id, computer, monotonic deadline [ns], length of origin
REQUEST = Struct("<B8s8sQ8sqB")

# A reply is one frame: REPLY, payload.   version, request id, status
REPLY = Struct("<BQB")
OK = 0  # the payload is the reply
REFUSED = 1  # the payload is the text of why: the handler raised, or the request could not be decoded
OTHER_SCHEMA = 2  # the payload is the text that names both sides' types
OTHER_TOPIC = 3  # the payload is the topic that this server serves

MAX_NAME = 255  # [B], of a topic and of a node


SERVERS_CLOCK = bytes(8)
"""In place of the computer, where the deadline of a request is by the server's own clock."""


def computer_id() -> bytes:
    """Eight bytes that two processes share when their monotonic clocks are the same: one boot, one time namespace."""
    boot = Path("/proc/sys/kernel/random/boot_id").read_bytes()
    with contextlib.suppress(OSError):  # a kernel without time namespaces
        boot += os.readlink("/proc/self/ns/time").encode()
    return hashlib.blake2b(boot, digest_size=8).digest()
