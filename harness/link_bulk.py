"""Both ends of the fast channel's things over an emulated channel, in simulated time."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from concurrent.futures import wait
from dataclasses import dataclass, field
from pathlib import Path

from harness.link_pair import secrets_of_both
from valor.link.bulk.fetcher import Fetcher
from valor.link.bulk.giver import Giver
from valor.link.bulk.things import Held, Opened, Thing
from valor.link.emulator import Conditions, Line
from valor.link.errors import BulkError, SealError
from valor.link.schedule import Windows
from valor.link.session import Session

STEP = 0.002  # [s]


@dataclass
class Shelf:
    """Files of a folder, and what is newest."""

    folder: Path
    things: list[Held] = field(default_factory=list)

    def newest(self) -> tuple[Thing, ...]:
        return tuple(self.things)

    def find(self, name: str) -> Thing | None:
        path = self.folder / name
        if not path.is_file():
            raise BulkError(f"{name}: there is no such bag")
        found = Opened(path)
        found.describe(found.digest())
        return found


class BulkPair:
    """Steps both ends.

    Attributes:
        now: of both [s].
        passed: datagrams that came out, those of the robot and those of the operator.
        refused: datagrams that an end did not take.
    """

    def __init__(
        self,
        robot: Path,
        operator: Path,
        conditions: Conditions,
        windows: Windows | None = None,
        seed: int = 0,
        damage: Callable[[bytes], bytes] = bytes,
    ) -> None:
        """Begin; ``damage``: what becomes of a datagram on its way."""
        self._secrets, self._folders, self._damage = secrets_of_both(), (robot, operator), damage
        self._lines = {True: Line(conditions, seed, windows), False: Line(conditions, seed + 1, windows)}
        self._flying: list[tuple[float, int, bool, bytes]] = []
        self._order = itertools.count()
        self.now, self.refused = 0.0, 0
        self.passed = {True: 0, False: 0}
        self.shelf = Shelf(robot)
        self._sessions = {True: self._session(True), False: self._session(False)}
        self.giver = Giver(self._sessions[True], self.shelf)
        self.fetcher = Fetcher(self._sessions[False], operator)
        self._meet()

    def _session(self, robot: bool) -> Session:
        return Session(self._secrets[not robot], robot, bytes(8))

    def _meet(self) -> None:
        """As over the slow channel, which is always on."""
        robot, operator = self._sessions[True], self._sessions[False]
        for _ in range(3):
            robot.hear(operator.hello(True))
            operator.hear(robot.hello(False))

    def restart(self, robot: bool) -> None:
        """One end is killed, and there again: nothing of it is closed."""
        self._sessions[robot] = self._session(robot)
        if robot:
            self.giver = Giver(self._sessions[True], self.shelf)
        else:
            self.fetcher = Fetcher(self._sessions[False], self._folders[1])
        self._meet()

    def step(self) -> None:
        """2 ms."""
        wait(future for _, future in self.fetcher._worker._under_way)  # disks know no simulated time
        self.now += STEP
        while self._flying and self._flying[0][0] <= self.now:
            _, _, to_robot, data = heapq.heappop(self._flying)
            self.passed[not to_robot] += 1
            try:
                (self.giver if to_robot else self.fetcher).receive(self._damage(data), self.now)
            except SealError:
                self.refused += 1
        for robot, end in ((True, self.giver), (False, self.fetcher)):
            for data in itertools.chain.from_iterable(end.turn(self.now)):
                for arrival in self._lines[robot].put(len(data), self.now):
                    heapq.heappush(self._flying, (arrival, next(self._order), not robot, data))

    def until(self, condition: Callable[[], object], longest: float) -> None:
        """Until something is so; fails if it does not become so."""
        end = self.now + longest
        while not condition():
            assert self.now < end, f"not within {longest:g} s of simulated time: {self.fetcher.errands.all}"
            self.step()
