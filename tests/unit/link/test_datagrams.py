"""Datagrams by the dozen, between real sockets: each comes as it was sent, with one system call or many."""

from __future__ import annotations

import errno
import random
import socket
from collections.abc import Iterator, Sequence
from typing import Any

import pytest

from valor.link.datagrams import AT_ONCE, Datagrams

LONG = 1450


class OneByOne(socket.socket):
    """Of a system that sends no datagrams together."""

    def sendmsg(self, *_arguments: Any) -> int:
        raise OSError(errno.EINVAL, "UDP_SEGMENT")


@pytest.fixture(params=[socket.socket, OneByOne])
def sender(request: pytest.FixtureRequest) -> Iterator[socket.socket]:
    with request.param(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        yield own


@pytest.fixture
def receiver() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        own.settimeout(20.0)
        yield own


@pytest.mark.parametrize("lengths", [[7], [LONG] * AT_ONCE, [LONG] * 5 + [1], [LONG, LONG]])
def test_each_comes_as_it_was_sent(sender: socket.socket, receiver: socket.socket, lengths: Sequence[int]) -> None:
    said = [random.Random(place).randbytes(length) for place, length in enumerate(lengths)]
    Datagrams(sender).send(said, receiver.getsockname())
    heard: list[bytes] = []
    listening = Datagrams(receiver)
    while len(heard) < len(said):
        together, address = listening.receive()
        assert address == sender.getsockname()
        heard += together
    assert heard == said


def test_who_takes_them_one_by_one_has_each_whole(sender: socket.socket, receiver: socket.socket) -> None:
    said = [bytes((place,)) * LONG for place in range(AT_ONCE)]
    Datagrams(sender).send(said, receiver.getsockname())
    assert [receiver.recv(65536) for _ in said] == said


def test_what_is_no_matter_of_the_system_is_raised() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own, pytest.raises(PermissionError):
        Datagrams(own).send([b"a", b"b"], ("255.255.255.255", 9))  # nobody has allowed this socket to tell all
