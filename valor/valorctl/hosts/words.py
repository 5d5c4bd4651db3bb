"""What processes say of themselves where no Bifrost message comes from: beyond the link, told by agents."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import bifrost
from valor.common.instance import Instance, Settings
from valor.valorctl.health import Listener, Word
from valor.valorctl.hosts.channel import HostError
from valor.valorctl.hosts.fleet import Fleet

AGAIN = 1.0  # between two questions [s]
LISTENING = 1.0  # for words that are on their way [s]
TIMEOUT = 5.0  # [s]


class FarListener(Listener):
    """Hears those of one's own network, and asks the agents of the other one; that waits for its answer."""

    def __init__(self, instance: Instance, settings: Settings, names: Iterable[str]) -> None:
        """Begin; ``settings``: of the instance.

        Raises:
            ConfigurationError: the network or keys are not readable, or this computer has not joined the deployment.
        """
        names = tuple(names)
        beyond = set(settings.processes_beyond(settings.here))
        super().__init__(instance, [name for name in names if name not in beyond])
        self.beyond = frozenset(beyond.intersection(names))
        wanted = {host.name: [name for name in host.processes if name in self.beyond] for host in settings.hosts}
        self._asked = {host: {"instance": instance.name, "names": each} for host, each in wanted.items() if each}
        self._fleet = Fleet(instance, settings)
        self._due = 0.0

    def close(self) -> None:
        """Leave, and hang up."""
        super().close()
        self._fleet.close()

    def listen(self, timeout: float, others: Sequence[bifrost.Subscriber[Any]] = ()) -> None:
        """As ``Listener.listen``; once in a while asks the agents."""
        if time.monotonic() >= self._due:
            for answer in self._fleet.switchboard.ask("words", self._asked, timeout=TIMEOUT).values():
                if not isinstance(answer, HostError):
                    now = time.monotonic()
                    self.words |= {name: Word(**row | {"heard": now - row["heard"]}) for name, row in answer.items()}
            self._due = time.monotonic() + AGAIN
        super().listen(timeout, others)

    def may_speak(self, names: Iterable[str]) -> set[str]:
        """As ``Listener.may_speak``; of those beyond the link the agents have told what there is."""
        return super().may_speak(set(names) - self.beyond)


def words_here(instance: Instance, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """What processes of this host have said, by name: ``Word``'s fields, but ``heard`` is how long ago that was [s]."""
    wanted = set(names)
    with Listener(instance, wanted) as listener:
        until = time.monotonic() + LISTENING
        while time.monotonic() < until and listener.may_speak(wanted - set(listener.words)):
            listener.listen(0.05)
        now = time.monotonic()
        return {name: asdict(word) | {"heard": now - word.heard} for name, word in listener.words.items()}
