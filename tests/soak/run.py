"""One step: the robot does something, something happens, and everything is looked at."""

from __future__ import annotations

import random
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import bifrost
from tests.soak.activities import ACTIVITIES, Activity, Going
from tests.soak.checks import GROWTH, GROWTH_OF, STEPPING, fit, growth, in_logs, outcomes
from tests.soak.events import Event, events
from tests.soak.rig import LOW, BrokenError, Rig
from valor.common.behaviors import Behavior
from valor.common.errors import ValorError

HELD = 0.05  # that a joint may give way while its robot is held [rad]
RECOVERED = 60.0  # in which everything must be ready again [s]
FRESH = 0.5  # of a MotionState of a robot in somebody's hands [s]
QUIET = 1.0  # for which mode and behavior must fit [robot time, s]
UPRIGHT = frozenset(Behavior) - {Behavior.FALL, Behavior.FREEZE, Behavior.IDLE, Behavior.GET_UP}


@dataclass
class Outcome:
    activity: str
    event: str
    before: str = ""  # behavior
    after: str = ""  # behavior
    ready: float = float("nan")  # from the end of the event until everything was ready again [s]
    moved: float = float("nan")  # largest movement of a joint until a command [rad]; NaN: without power, or a new world
    failures: list[str] = field(default_factory=list)

    def line(self) -> str:
        failed = "; ".join(f"FAILED: {each}" for each in self.failures)
        return (
            f"{self.activity} × {self.event}: {self.before} → {self.after}, ready after {self.ready:.2f} s"
            f"{'; ' if failed else ''}{failed}"
        )


class Soak:
    """Steps of one system after the other."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        rig.up()
        self._world = "device_emulators" if "device_emulators" in rig.pids() else "comms_manager"
        self.events = events(list(rig.pids()))

    def choose(self, rng: random.Random) -> tuple[str, str]:
        activity = _weighted(rng, ((name, each.weight) for name, each in ACTIVITIES.items()))
        return activity, _weighted(rng, ((name, each.weight) for name, each in self.events.items()))

    def step(self, activity: str, event: str, rng: random.Random) -> Outcome:
        """Make one; the robot stands before and afterwards."""
        outcome = Outcome(activity, event)
        going: Going | None = None
        trouble = ""
        try:
            going = ACTIVITIES[activity].begin(self._rig, rng)
            time.sleep(rng.uniform(0.0, 1.5))
            self._happen(outcome, ACTIVITIES[activity], self.events[event], rng)
        except (BrokenError, ValorError, bifrost.Error, TimeoutError) as error:
            outcome.failures.append(str(error))
        finally:
            if going is not None:
                trouble = going.end()
        if event == "nothing" and trouble:
            outcome.failures.append(f"{activity}: {trouble}")
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
        missing: list[str] = []

        def recovered() -> bool:
            missing[:] = self._missing(event, before_pids, ended)
            return not missing

        try:
            rig.wait(recovered, "all well again", RECOVERED)
        except BrokenError as error:
            raise BrokenError(f"{error}; missing: {', '.join(missing)}") from None
        outcome.ready = time.monotonic() - ended
        self._quiet()
        outcome.after = rig.behavior
        joint, outcome.moved = rig.tap.moved()
        allowed = frozenset[Behavior]().union(*(outcomes(event.kind, name, before) for name in event.hit or ("",)))
        if rig.behavior not in allowed:
            reason = rig.tap.state.reason if rig.tap.state else ""
            outcome.failures.append(f"{rig.behavior} ({reason}); expected {', '.join(sorted(allowed))}")
        another = event.kind == "kill" and self._world in event.hit
        if another or event.kind == "unplug":  # and what has no power is not held
            outcome.moved = float("nan")
        if event.kind and activity.held and before not in STEPPING and outcome.moved > HELD:
            outcome.failures.append(f"{joint} moved {outcome.moved:.3f} rad")
        if rig.behavior is Behavior.FALL:
            rig.wait(lambda: rig.system.status()["fallen"], "`valorctl status` saying that it has fallen", 20.0)
        if rig.tap.height < LOW and rig.behavior in UPRIGHT:
            outcome.failures.append(f"lies on the floor (pelvis at {rig.tap.height:.2f} m) and says {rig.behavior}")

    def _missing(self, event: Event, hit: Mapping[str, int], since: float) -> list[str]:
        rig = self._rig
        unready = rig.unready(hit if event.kind else {}, since)
        lost = [] if time.monotonic() - rig.tap.received_at < FRESH else ["MotionState"]
        lost += ["the reflex"] if rig.tap.reflex else []
        unfit = [] if fit(rig.tap.mode, rig.behavior) else [f"mode {rig.tap.mode}"]
        return [*unready, *lost, *unfit]

    def _quiet(self) -> None:
        """Nothing is asked for a while; what is reported then must fit."""
        rig = self._rig
        began = rig.time
        rig.wait(lambda: not began <= rig.time < began + QUIET, "robot time going on")
        rig.wait(lambda: fit(rig.tap.mode, rig.behavior), f"mode {rig.tap.mode} fitting {rig.behavior}", 20.0)

    def _back(self, outcome: Outcome) -> None:
        rig = self._rig
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

    def close(self) -> list[str]:
        """Take the system down; returns what was not as it must be over all of its life."""
        rig = self._rig
        found = rig.down() + in_logs(rig.instance.logs)
        rig.instance.logs.rename(rig.instance.logs.with_name(f"logs-{rig.ups}"))  # each life's words by themselves
        for (name, pid), samples in rig.memory.items():
            if (grown := growth(samples)) > GROWTH_OF.get(name, GROWTH):
                found.append(f"{name} ({pid}) grew by {grown:.1f} MiB")
        rig.memory.clear()
        return found


def _weighted(rng: random.Random, rows: Iterable[tuple[str, float]]) -> str:
    names, weights = zip(*rows, strict=True)
    return str(rng.choices(names, weights)[0])
