"""Traffic classes of the link, most urgent first: priorities, deadlines, repetition; byte budgets and rates."""

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from valor.common.instance import LINK_RATE


class MessageClass(IntEnum):
    """First byte of every record."""

    STOP = 0
    COMMAND = 1
    STREAM = 2
    ANSWER = 3
    EVENT = 4
    ACKNOWLEDGEMENT = 5
    STATE = 6
    PROGRESS = 7
    PICTURE = 9  # 8 was used by earlier versions


@dataclass(frozen=True)
class TrafficClass:
    """One row of the table."""

    kind: MessageClass
    deadline: float | None = None  # time after sending at which the robot's end rejects a message [s]
    retry_after: float = 0.0  # time until the first repetition [s], doubled each time; not of unreliable classes
    urgent: bool = False  # sent at once, even if that overdraws the budget
    capacity: int = 64  # waiting messages; without a deadline the oldest is discarded, else a new one rejected
    part_size: int = 40  # content in one record [B]; small where it shares a datagram with a state


CLASSES: tuple[TrafficClass, ...] = (
    # Soft stop, emergency stop.
    TrafficClass(MessageClass.STOP, deadline=10.0, retry_after=0.2, urgent=True),
    # Of both ends: what has been received. Unreliable.
    TrafficClass(MessageClass.ACKNOWLEDGEMENT),
    # Goals, modes, plans, cancellations.
    TrafficClass(MessageClass.COMMAND, deadline=6.0, retry_after=1.0, part_size=112),
    # Velocities. Unreliable: only the latest is sent.
    TrafficClass(MessageClass.STREAM, deadline=0.5),
    # Result of a command.
    TrafficClass(MessageClass.ANSWER, retry_after=1.0),
    # Robot state. Unreliable: only the latest is sent.
    TrafficClass(MessageClass.STATE),
    # Progress of step plans and hand goals.
    TrafficClass(MessageClass.PROGRESS, retry_after=1.5),
    # Rejections.
    TrafficClass(MessageClass.EVENT, retry_after=3.0),
    # Latest camera picture, on the fast channel only (picture.py). Unreliable.
    TrafficClass(MessageClass.PICTURE),
)
BY_CLASS = {each.kind: each for each in CLASSES}

HEADERS = 28  # IPv4 and UDP [B]


@dataclass(frozen=True)
class Rates:
    """Rates of one end on the slow channel."""

    budget: float  # everything that it sends, headers included [B/s]
    burst: float  # unspent budget that it may save [B]
    period: float  # of its states, or of its acknowledgements [s]
    loaded_period: float | None = None  # the same while messages wait [s]; None: messages are sent at once


def rates(channel: float, robot_end: bool) -> Rates:
    """Rates of one end on a slow channel that carries ``channel`` [B/s] in both directions together."""
    slower = LINK_RATE / channel
    if robot_end:
        return Rates(budget=940.0 / slower, burst=24.0, period=0.095 * slower, loaded_period=0.1 * slower)
    return Rates(budget=240.0 / slower, burst=150.0, period=0.5 * slower)


LEAST_DEBT = 200.0  # more than one datagram [B]


class Budget:
    """Token bucket of bytes. It may be overdrawn; the debt, of at most 1 s, is paid before all but stops."""

    def __init__(self, rates: Rates, now: float) -> None:
        self._rates, self._bytes, self._at = rates, rates.burst, now

    def left(self, now: float) -> float:
        """Bytes left [B]; negative: a debt."""
        self._bytes = min(self._rates.burst, self._bytes + self._rates.budget * (now - self._at))
        self._at = now
        return self._bytes

    def spend(self, size: int, now: float) -> None:
        """Account for a datagram of ``size`` [B] without headers."""
        self._bytes = max(self.left(now) - size - HEADERS, -max(self._rates.budget, LEAST_DEBT))


class Meter:
    """Bytes by class, headers included; ``total``: since the start."""

    WINDOW = 5.0  # of the rates [s]

    def __init__(self) -> None:
        self.total: Counter[str] = Counter()
        self._recent: deque[tuple[float, Mapping[str, int]]] = deque()

    def count(self, shares: Mapping[str, int], now: float) -> None:
        """Add one datagram; ``shares``: bytes by class."""
        self.total.update(shares)
        self._recent.append((now, shares))

    def rates(self, now: float) -> dict[str, float]:
        """Rates by class [B/s]."""
        while self._recent and self._recent[0][0] < now - self.WINDOW:
            self._recent.popleft()
        sums: Counter[str] = Counter()
        for _, shares in self._recent:
            sums.update(shares)
        return {name: size / self.WINDOW for name, size in sums.items()}
