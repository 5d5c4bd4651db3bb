"""Headers of messages, as specified in ``docs/bifrost.md``. All numbers are little-endian and unaligned."""

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
# Byte between NUL and PUBLICATION in a latched publisher's last message to one late subscriber.
LATCHED = b"\xff"

# A request is one frame: topic, NUL, REQUEST, origin, payload.
# version, request's schema hash, reply's schema hash, request id, computer, monotonic deadline [ns], length of origin
REQUEST = Struct("<B8s8sQ8sqB")

# A reply is one frame: REPLY, payload.   version, request id, status
REPLY = Struct("<BQB")
OK = 0  # the payload is the reply
REFUSED = 1  # the payload is the reason: the handler raised, or the request is not decodable
OTHER_SCHEMA = 2  # the payload names the types of both sides
OTHER_TOPIC = 3  # the payload is the topic of this server

MAX_NAME = 255  # [B], of a topic and of a node


SERVERS_CLOCK = bytes(8)
"""Replaces the computer in a request whose deadline is by the server's clock."""


def computer_id() -> bytes:
    """Eight bytes that identify the monotonic clock: boot and time namespace."""
    boot = Path("/proc/sys/kernel/random/boot_id").read_bytes()
    with contextlib.suppress(OSError):  # a kernel without time namespaces
        boot += os.readlink("/proc/self/ns/time").encode()
    return hashlib.blake2b(boot, digest_size=8).digest()
