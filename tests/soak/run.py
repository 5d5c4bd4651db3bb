"""One step: the robot does something, something happens, and everything is looked at."""

from __future__ import annotations

import random
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import bifrost
from tests.soak.activities import ACTIVITIES, Activity, Going
from tests.soak.checks import GROWTH, HELD_UP, growth, in_logs, unreadable
from tests.soak.event import Event
from tests.soak.events import events
from tests.soak.rig import LOW, BrokenError, Rig
from tests.soak.rules import STEPPING, outcomes
from valor.common.behaviors import Behavior
from valor.common.errors import ValorError

HELD = 0.05  # that a joint may give way while its robot is held [rad]
RECOVERED = 60.0  # in which everything must be ready again [s]
FRESH = 0.5  # of a MotionState of a robot in somebody's hands [s]
QUIET = 1.0  # for which mode and behavior must fit [robot time, s]
UPRIGHT = frozenset(Behavior) - {Behavior.FALL, Behavior.FREEZE, Behavior.IDLE, Behavior.GET_UP}


@dataclass
class Outcome:
    """What became of a step.

    Attributes:
        activity, event: names in their tables.
        before, after: behaviors.
        ready: from the end of the event until everything was ready again [s].
        last: what was waited for last.
        stands: from then until the robot stood, by commands [s]; NaN: another ``up`` was needed.
        moved: the largest movement of a joint, until somebody commanded [rad]; NaN: it is another robot, or one of
            which a limb had no power.
        failures: what was not as it must be.
    """

    activity: str
    event: str
    before: str = ""
    after: str = ""
    ready: float = float("nan")
    last: str = ""
    stands: float = float("nan")
    moved: float = float("nan")
    failures: list[str] = field(default_factory=list)

    def line(self) -> str:
        """For people."""
        failed = "; ".join(f"FAILED: {each}" for each in self.failures)
        of = f" ({self.last})" if self.last else ""
        return (
            f"{self.activity} × {self.event}: {self.before} → {self.after}, ready after {self.ready:.2f} s{of}, "
            f"stands after {self.stands:.1f} s{'; ' if failed else ''}{failed}"
        )


class Soak:
    """Steps of one system after the other."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._missing = ""
        rig.up()
        self._world = "device_emulators" if "device_emulators" in rig.pids() else "comms_manager"
        self.events = events(list(rig.pids()), rig.own_disk)

    def choose(self, rng: random.Random) -> tuple[str, str]:
        """An activity and an event, by their weights."""
        activity = _weighted(rng, ((name, each.weight) for name, each in ACTIVITIES.items()))
        possible = ((name, each.weight) for name, each in self.events.items() if each.possible(activity))
        return activity, _weighted(rng, possible)

    def step(self, activity: str, event: str, rng: random.Random) -> Outcome:
        """Make one; the robot stands before and afterwards."""
        outcome = Outcome(activity, event)
        going: Going | None = None
        try:
            going = ACTIVITIES[activity].begin(self._rig, rng)
            time.sleep(rng.uniform(0.0, 1.5))
            self._happen(outcome, ACTIVITIES[activity], self.events[event], rng)
        except (BrokenError, ValorError, bifrost.Error, TimeoutError) as error:
            outcome.failures.append(str(error))
        finally:
            if going is not None:
                going.end()
        if going is not None and event == "nothing" and going.trouble:
            outcome.failures.append(f"{activity}: {going.trouble}")
        self._back(outcome)
        return outcome

    def _happen(self, outcome: Outcome, activity: Activity, event: Event, rng: random.Random) -> None:
        rig = self._rig
        before = rig.behavior
        outcome.before = before
        pids = rig.pids()
        before_pids = {name: pids.get(name, 0) if event.kind == "kill" else 0 for name in event.hit}
        rig.tap.mark()
        outcome.failures += event.happen(rig, rng, event.process)
        ended = time.monotonic()
        self._missing = ""
        try:
            rig.wait(lambda: self._recovered(event, before_pids, ended), "all well again", RECOVERED)
        finally:
            outcome.last = self._missing
        outcome.ready = time.monotonic() - ended
        self._quiet()
        outcome.after = rig.behavior
        joint, outcome.moved = rig.tap.moved()
        allowed = frozenset[Behavior]().union(*(outcomes(event.kind, name, before) for name in event.hit or ("",)))
        if not event.commands and rig.behavior not in allowed:
            outcome.failures.append(f"{rig.behavior} ({self._reason()}); expected {', '.join(sorted(allowed))}")
        another = event.kind == "up" or (event.kind in ("kill", "cap") and self._world in event.hit)
        if another or event.kind == "unplug":  # and what has no power is not held
            outcome.moved = float("nan")
        if event.kind and activity.held and before not in STEPPING and outcome.moved > HELD:
            outcome.failures.append(f"{joint} moved {outcome.moved:.3f} rad")
        if rig.behavior is Behavior.FALL:
            rig.wait(lambda: rig.system.status()["fallen"], "`valorctl status` saying that it has fallen", 20.0)
        if rig.tap.height < LOW and rig.behavior in UPRIGHT:
            outcome.failures.append(f"lies on the floor (pelvis at {rig.tap.height:.2f} m) and says {rig.behavior}")

    def _reason(self) -> str:
        return self._rig.tap.state.reason if self._rig.tap.state else ""

    def _recovered(self, event: Event, hit: Mapping[str, int], since: float) -> bool:
        rig = self._rig
        unready = rig.unready(hit if event.kind else {}, since)
        lost = [] if time.monotonic() - rig.tap.heard < FRESH else ["MotionState"]
        lost += ["the reflex"] if rig.tap.reflex else []
        unfit = [] if rig.modes.fit(rig.tap.mode, rig.behavior) or event.commands else [f"mode {rig.tap.mode}"]
        missing = ", ".join([*unready, *lost, *unfit])
        self._missing = missing or self._missing
        return not missing

    def _quiet(self) -> None:
        """Nothing is asked for a while; what is reported then must fit."""
        rig = self._rig
        began = rig.time
        rig.wait(lambda: not began <= rig.time < began + QUIET, "robot time going on")
        rig.wait(lambda: rig.modes.fit(rig.tap.mode, rig.behavior), f"mode {rig.tap.mode} fitting {rig.behavior}", 20.0)

    def _back(self, outcome: Outcome) -> None:
        rig = self._rig
        began = time.monotonic()
        lost = True
        try:
            lost = rig.stand()
        except (BrokenError, ValorError) as error:
            outcome.failures.append(f"does not come back to stand: {error}")
        outcome.failures += rig.tap.take_faults()
        rig.sample()
        if lost:
            outcome.failures += self.close()
            rig.up()
        else:
            outcome.stands = time.monotonic() - began

    def close(self) -> list[str]:
        """Take the system down; returns what was not as it must be over all of its life."""
        rig = self._rig
        found = rig.down() + [each for each in in_logs(rig.instance.logs) if each.partition(".")[0] not in rig.excused]
        rig.excused.clear()
        rig.instance.logs.rename(rig.instance.logs.with_name(f"logs-{rig.ups}"))  # each life's words by themselves
        found += unreadable(rig.instance.bags)
        for (name, pid), samples in rig.memory.items():
            if (grown := growth(samples)) > HELD_UP.get(name, GROWTH):
                found.append(f"{name} ({pid}) grew by {grown:.1f} MiB")
        rig.memory.clear()
        return found


def _weighted(rng: random.Random, rows: Iterable[tuple[str, float]]) -> str:
    names, weights = zip(*rows, strict=True)
    return str(rng.choices(names, weights)[0])
