"""What travels on the link, the most urgent first: one table of priorities, rates, deadlines and channels.

The scheduler, the statistics and the documentation follow from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Kind(IntEnum):
    """On the wire, in front of every record."""

    STOP = 0
    COMMAND = 1
    STREAM = 2
    ANSWER = 3
    EVENT = 4
    ACKNOWLEDGEMENT = 5
    STATE = 6
    PROGRESS = 7
    REPORT = 8


@dataclass(frozen=True)
class Class:
    """One line of the table.

    Attributes:
        reliable: sent again until it is acknowledged, its deadline has passed, or the session ends.
        deadline: from when it was given to the operator's end until the robot's end refuses it [s]; None: it has none.
        again: until it is first sent again; doubles each time [s].
        newest: a newer one takes the place of one that waits.
        indebted: sent at once, whatever the budget says; what follows pays.
        most: messages that may wait; of those without a deadline the oldest goes when another comes.
        part: of content in one record: what comes beside states is in small ones [B].
    """

    kind: Kind
    description: str
    reliable: bool = True
    deadline: float | None = None
    again: float = 0.0
    newest: bool = False
    indebted: bool = False
    most: int = 64
    part: int = 40


# fmt: off
CLASSES: tuple[Class, ...] = (
    #     kind                  description                              reliable  deadline       again
    Class(Kind.STOP,            "soft stop, emergency stop",             True, deadline=10.0, again=0.2, indebted=True),
    Class(Kind.ACKNOWLEDGEMENT, "what has arrived, of both ends",        False,    newest=True),
    Class(Kind.COMMAND,         "goals, modes, plans, cancellations",    True,     deadline=6.0,  again=1.0, part=112),
    Class(Kind.STREAM,          "velocities: the newest alone counts",   False,    deadline=0.5,  newest=True),
    Class(Kind.ANSWER,          "what became of a command",              True,     again=1.0),
    Class(Kind.STATE,           "the robot's state",                     False,    newest=True),
    Class(Kind.PROGRESS,        "how plans and hands' goals fare",       True,     again=1.5,    newest=True),
    Class(Kind.EVENT,           "refusals, faults, in words",            True,     again=3.0),
    Class(Kind.REPORT,          "what was said to a verb of valorctl",   True,     again=3.0),
)
# fmt: on
BY_KIND = {each.kind: each for each in CLASSES}


class Bulk(IntEnum):
    """What travels on the fast channel alone, as leftovers allow, the most urgent first.

    Of another type than ``Kind``, so that nothing sends it on the channel that is always on.
    """

    PICTURE = 0  # the newest still picture: its window opens with it
    LISTING = 1  # which bags there are
    BAG = 2  # one that was asked for


HEADERS = 28  # of IPv4 and UDP [B]
ALWAYS_ON = 1200.0  # of both ways together [B/s]: 9,600 bit/s


@dataclass(frozen=True)
class Rates:
    """Of one end.

    Attributes:
        budget: of all that it sends on the channel that is always on, headers included [B/s].
        burst: how much unspent budget it keeps [B].
        period: of what it sends by itself, states or acknowledgements [s].
        slowest: the same while messages wait: they take what that leaves; None: they go at once [s].
    """

    budget: float
    burst: float
    period: float
    slowest: float | None = None


ROBOT = Rates(budget=940.0, burst=24.0, period=0.095, slowest=0.1)
OPERATOR = Rates(budget=240.0, burst=150.0, period=0.5)
