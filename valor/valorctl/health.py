"""How the processes of an instance fare: supervisord's word on the process together with the process' own.

A process is ready when it runs, the one that runs says so itself (its pid is that of supervisord), and it goes on
saying so. bifrostd says it by answering; the services say it by their ``Statistics``.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

import bifrost
from valor.common.instance import Instance
from valor.common.messages import Statistics
from valor.common.processes import DAEMON
from valor.common.topics import STATISTICS
from valor.valorctl.supervision import ProcessInfo, ProcessState

SILENCE = 3.0  # without a word for this long, a process is not ready, whatever it said before [s]
START_GRACE = 10.0  # a process may take this long to its first word [s]

State = Literal["starting", "ready", "degraded", "stopped", "failed"]


@dataclass(frozen=True)
class Word:
    """What a process said of itself, and when [``time.monotonic()``, s]."""

    pid: int
    state: str
    detail: str
    cpu_percent: float
    memory_mib: float
    heard: float


@dataclass(frozen=True)
class Health:
    """How one process fares."""

    name: str
    state: State
    pid: int  # 0: does not run
    cpu_percent: float | None  # of one core, over the last second; None: not known
    memory_mib: float | None
    restarts: int  # after ends that nobody asked for
    detail: str  # what it waits for, or what is wrong


def judge(info: ProcessInfo, word: Word | None, now: float, restarts: int = 0) -> Health:
    """The truth from both words.

    Args:
        info: supervisord's.
        word: the newest of the process, if any.
        now: ``time.monotonic()`` [s].
        restarts: as counted by supervisord.
    """
    if word is not None and word.pid != info.pid:
        word = None  # of the process that was there before
    state, detail = _state(info, word, now)
    return Health(
        name=info.name,
        state=state,
        pid=info.pid,
        cpu_percent=word.cpu_percent if word else None,
        memory_mib=word.memory_mib if word else None,
        restarts=restarts,
        detail=detail,
    )


def _state(info: ProcessInfo, word: Word | None, now: float) -> tuple[State, str]:
    match info.state:
        case ProcessState.STOPPED:
            return "stopped", ""
        case ProcessState.STOPPING:
            return "stopped", "stopping"
        case ProcessState.EXITED:
            return "failed", f"ended with exit status {info.exit_status}"
        case ProcessState.FATAL | ProcessState.UNKNOWN | ProcessState.BACKOFF:
            return "failed", info.problem or "cannot be started"
    if word is None:
        if info.uptime <= START_GRACE:
            return "starting", "no word from it yet"
        return "failed", f"runs, but no word from it in {info.uptime:.0f} s"
    if (silent := now - word.heard) > SILENCE:
        return "failed", f"runs, but silent for {silent:.1f} s"
    if word.state == "ready":
        return "ready", word.detail
    if word.state == "degraded":
        return "degraded", word.detail
    if word.state == "stopping":
        return "stopped", "stopping"
    return "starting", word.detail


def _published(topic: bifrost.TopicInfo | None) -> bool:
    return topic is not None and bool(topic.publishers)


class Listener:
    """Hears the words of an instance's processes. Used from one thread.

    Attributes:
        words: the newest of each process.
    """

    def __init__(self, instance: Instance, names: Iterable[str]) -> None:
        """Raise ``bifrost.ConfigurationError`` when the network or the keys are not readable."""
        self._network = bifrost.Network.load(instance.network_file, instance.keys)
        self.node = bifrost.Node("valorctl", network=self._network)
        self._names = tuple(names)
        self._subscribers = [STATISTICS[name].subscriber(self.node) for name in self._names if name in STATISTICS]
        self.words: dict[str, Word] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave."""
        self.node.close()

    def listen(self, timeout: float, others: Sequence[bifrost.Subscriber[Any]] = ()) -> None:
        """Take in what is said within ``timeout`` [s]; returns as soon as something was, or has come to others."""
        if DAEMON in self._names:
            self._ask_daemon()
        for subscriber in bifrost.wait([*self._subscribers, *others], timeout=timeout):
            received = subscriber.latest() if subscriber in self._subscribers else None
            if received is None:
                continue
            said: Statistics = received.message
            self.words[said.service] = Word(
                said.pid, said.state, said.detail, said.cpu_percent, said.memory_mib, received.stamp * 1e-9
            )

    def may_speak(self, names: Iterable[str]) -> set[str]:
        """Those of some processes whose word may be on its way: not where the network knows nobody who would say it."""
        names = set(names)
        if not names or not self.node.discovery.registered:
            return names
        topics = self.node.graph().topics
        return {name for name in names if name not in STATISTICS or _published(topics.get(STATISTICS[name].name))}

    def _ask_daemon(self) -> None:
        word = self.words.get(DAEMON)
        if word is not None and time.monotonic() - word.heard < 0.5 * SILENCE:
            return
        if info := bifrost.daemon_alive(self._network, timeout=0.2):
            self.words[DAEMON] = Word(
                info.pid, "ready", info.refusal, info.cpu_percent, info.memory_mib, time.monotonic()
            )
