"""Bifrost with a subscriber that takes every message."""

from benchmarks.interprocess.transports import bifrost_typed
from benchmarks.interprocess.transports.bifrost_typed import Sender

__all__ = ["Receiver", "Sender"]


class Receiver(bifrost_typed.Receiver):
    """A node with one queue subscriber."""

    QUEUE = 1000
