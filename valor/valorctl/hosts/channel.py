"""Between `valorctl` and the agents: requests and replies over CURVE, each with a deadline by the agent's own clock.

A cable that is put back delivers what was sent into it before. So a request says, by the clock of the agent that it
goes to, until when it holds; the agent refuses it afterwards. That clock is told with every reply, the first of which
answers a question that changes nothing.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Self

import msgspec
import zmq

import bifrost
from bifrost import security
from valor.common.errors import ValorError

ANSWER = 3.0  # an agent that lives answers within [s]
PULSE = 1.0  # between two signs of life that are asked for while a longer work goes on [s]
AGAIN = 10.0  # a host that did not answer is asked again after [s]
HELLO = "hello"  # the question that changes nothing and needs no deadline
_THREADS = 8
_LOOK = 0.01  # while something is being worked on [s]
_IDLE = 0.5  # [s]


class Request(msgspec.Struct):
    """To an agent; ``until``: by its monotonic clock [ns]."""

    number: int
    verb: str
    until: int
    arguments: dict[str, Any] = {}


class Reply(msgspec.Struct):
    """From an agent; ``clock``: its monotonic one when it took the request and when it replied [ns]."""

    number: int
    taken: int
    clock: int
    result: Any = None
    error: str | None = None


class HostError(ValorError):
    """A host refused, or could not do, what it was asked for; names it."""


class GoneError(HostError):
    """A host does not answer."""


Verb = Callable[..., Any]


class Desk:
    """An agent's end: hands requests to verbs, each in a thread, and replies."""

    def __init__(self, network: bifrost.Network, verbs: Mapping[str, Verb]) -> None:
        """Listen.

        Raises:
            HostError: the address is not this computer's, or somebody listens there.
        """
        self._verbs = dict(verbs)
        self._context = security.new_context()
        self._gate = security.Gate(self._context, network)
        self._socket = security.listening_socket(self._context, zmq.ROUTER, network)
        try:
            self._socket.bind(network.computer.daemon)
        except zmq.ZMQError as error:
            self.close()
            raise HostError(f"cannot listen at {network.computer.daemon}: {error.strerror}") from None
        self._workers = ThreadPoolExecutor(_THREADS, "verb")
        self._jobs: dict[Future[Any], tuple[bytes, Request, int]] = {}

    def run_once(self) -> None:
        """Take what comes within half a second, and reply to what is done."""
        poller = zmq.Poller()
        for socket in (self._gate.socket, self._socket):
            poller.register(socket, zmq.POLLIN)
        ready = dict(poller.poll(int(1e3 * (_LOOK if self._jobs else _IDLE))))
        if self._gate.socket in ready:
            self._gate.answer()
        if self._socket in ready:
            self._receive()
        for job in [job for job in self._jobs if job.done()]:
            self._reply(job)

    def close(self) -> None:
        """Listen no more; what is being worked on is finished."""
        if hasattr(self, "_workers"):
            self._workers.shutdown()
        self._socket.close()
        self._gate.close()
        self._context.term()

    def _receive(self) -> None:
        while True:
            try:
                frames = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            taken = time.monotonic_ns()
            try:
                request = msgspec.msgpack.decode(frames[-1], type=Request)
            except (msgspec.DecodeError, RecursionError):
                continue  # of a member, but of another version
            if len(frames) == 2:
                self._jobs[self._workers.submit(self._do, request, taken)] = (frames[0], request, taken)

    def _do(self, request: Request, taken: int) -> Any:
        if request.verb not in self._verbs:
            raise ValorError(f"{request.verb}: no verb of this agent's; expected the same valor on all hosts")
        if request.verb != HELLO and taken > request.until:
            late = 1e-9 * (taken - request.until)
            raise ValorError(f"{request.verb}: came {late:.1f} s after it had ceased to hold; nothing was done")
        return self._verbs[request.verb](**request.arguments)

    def _reply(self, job: Future[Any]) -> None:
        peer, request, taken = self._jobs.pop(job)
        reply = Reply(request.number, taken, 0)
        try:
            reply.result = job.result()
        except (ValorError, bifrost.Error) as error:
            reply.error = str(error)
        except Exception as error:
            reply.error = f"{request.verb}: {type(error).__name__}: {error}"
        reply.clock = time.monotonic_ns()
        try:
            self._socket.send_multipart((peer, msgspec.msgpack.encode(reply)), zmq.NOBLOCK)
        except zmq.ZMQError:
            return  # whoever asked is gone


@dataclass
class _Line:
    """To one agent."""

    name: str
    address: str
    socket: zmq.Socket[bytes]
    ahead: int | None = None  # at least so much its monotonic clock is ahead of ours [ns]
    heard: float = 0.0  # monotonic [s]
    given_up: float = -math.inf  # monotonic [s]
    replies: dict[int, Reply] = field(default_factory=dict)


class Switchboard:
    """The commanding end: a line to each agent. A context manager; used from one thread."""

    def __init__(self, network: bifrost.Network, again: float = AGAIN) -> None:
        """As a host of the agents' network; ``again``: when one that did not answer is asked again [s]."""
        self._again = again
        self._context = security.new_context()
        self._lines: dict[str, _Line] = {}
        self._numbers = itertools.count(1)
        for computer in network.computers:
            socket = security.connecting_socket(self._context, zmq.DEALER, network)
            security.connect(socket, computer.daemon, network.grants.owners[computer.name].encode())
            self._lines[computer.name] = _Line(computer.name, computer.host, socket)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Hang up."""
        for line in self._lines.values():
            line.socket.close()
        self._context.term()

    @property
    def names(self) -> tuple[str, ...]:
        """Of all hosts."""
        return tuple(self._lines)

    def ask(
        self,
        verb: str,
        arguments: Mapping[str, Mapping[str, Any]],
        *,
        timeout: float = ANSWER,
        check: Callable[[], None] = lambda: None,
    ) -> dict[str, Any]:
        """Ask several hosts at once.

        Args:
            verb: of the agents.
            arguments: by host, those asked.
            timeout: for the work [s]. A host that shows no sign of life is given up sooner.
            check: called while waiting; may raise to give up.

        Returns:
            By host what it answered, or the ``HostError``.
        """
        asked = dict(arguments)
        silent = [name for name in asked if time.monotonic() - self._lines[name].given_up < self._again]
        new = [name for name in asked if self._lines[name].ahead is None and name not in silent]
        silent += self._greet(new, check)
        found: dict[str, Any] = {name: self._gone(name) for name in silent}
        sent = {name: self._send(name, verb, dict(asked[name]), timeout) for name in asked if name not in silent}
        found |= self._await(sent, timeout, check)
        return {name: found[name] for name in asked}

    def _greet(self, names: Iterable[str], check: Callable[[], None]) -> list[str]:
        """Learn the clocks of agents; returns those that do not answer."""
        sent = {name: self._send(name, HELLO, {}, ANSWER) for name in names}
        found = self._await(sent, ANSWER, check)
        return [name for name, answer in found.items() if isinstance(answer, GoneError)]

    def _send(self, name: str, verb: str, arguments: dict[str, Any], timeout: float) -> int:
        line, number = self._lines[name], next(self._numbers)
        until = time.monotonic_ns() + (line.ahead or 0) + round(1e9 * timeout)
        with contextlib.suppress(zmq.Again):  # it is not answered, then
            line.socket.send(msgspec.msgpack.encode(Request(number, verb, until, arguments)), zmq.NOBLOCK)
        return number

    def _await(self, sent: Mapping[str, int], timeout: float, check: Callable[[], None]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        waiting = dict(sent)
        began = time.monotonic()
        pulse = began + PULSE
        poller = zmq.Poller()
        for name in waiting:
            self._lines[name].heard = began
            poller.register(self._lines[name].socket, zmq.POLLIN)
        while waiting:
            check()
            ready = dict(poller.poll(50))
            now = time.monotonic()
            for name, number in list(waiting.items()):
                line = self._lines[name]
                if line.socket in ready:
                    self._receive(line)
                if (reply := line.replies.pop(number, None)) is not None:
                    found[name] = reply.result if reply.error is None else HostError(f"{name}: {reply.error}")
                elif now - line.heard > ANSWER:
                    found[name] = self._gone(name)
                elif now - began > timeout + ANSWER:
                    found[name] = HostError(f"{name}: not done within {timeout:g} s")
                if name in found:
                    del waiting[name]
                    poller.unregister(line.socket)
                elif now > pulse:
                    self._send(name, HELLO, {}, ANSWER)
            if now > pulse:
                pulse = now + PULSE
        return found

    def _receive(self, line: _Line) -> None:
        while True:
            try:
                content = line.socket.recv(zmq.NOBLOCK)
            except zmq.Again:
                return
            try:
                reply = msgspec.msgpack.decode(content, type=Reply)
            except (msgspec.DecodeError, RecursionError):
                continue
            line.heard, line.given_up = time.monotonic(), -math.inf
            # The reply has been on its way: that clock is ahead by this, or by more.
            ahead = reply.clock - time.monotonic_ns()
            line.ahead = ahead if line.ahead is None else max(line.ahead, ahead)
            line.replies[reply.number] = reply

    def _gone(self, name: str) -> GoneError:
        line = self._lines[name]
        if time.monotonic() - line.given_up >= self._again:
            line.given_up = time.monotonic()
        return GoneError(f"{name} ({line.address}): no answer of its agent; `valorctl host agent` runs there?")
