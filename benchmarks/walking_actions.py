"""What a robot does in a run of ``walking.py``: walk by velocity, take a plan's steps, be pushed, stand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, Self

from benchmarks.flights import over_stairs
from benchmarks.live_system import System
from harness.places import ROBOTS
from valor.common.behaviors import WALKING
from valor.robot.description import RobotDescription
from valor.robot.step_plan import PlanStep
from valor.simulation import worlds
from valor.simulation.worlds.stairs import Stairs
from valor.valorctl import stepping
from valor.valorctl.walking import Order, walk

ROBOT = ROBOTS / "escher"
STANDING = (-0.012, 0.1)  # x and |y| of the soles at the start [m]
STEP = 0.25  # length on a floor taken for flat [m]
QUICK_SECONDS, QUICK_DISTANCE, QUICK_PUSHES = 5.0, 2.0, 2  # of a run with --quick


class Action(Protocol):
    """What a run does. It says what went wrong beside falling; nothing: it did what it was to do."""

    def __call__(self, system: System, seed: int) -> str: ...

    @property
    def quick(self) -> Self:
        """The same, shorter."""


@dataclass(frozen=True)
class Velocity:
    """Walk by velocity, as ``valorctl walk`` does."""

    order: Order

    def __call__(self, system: System, seed: int) -> str:
        result = walk(system.instance, self.order, system.observer.hear)
        wanted = self.order.distance
        return result.reason or ("did not get there" if wanted and result.distance < 0.98 * wanted else "")

    @property
    def quick(self) -> Self:
        order = self.order
        if order.distance is not None:
            return replace(self, order=replace(order, distance=QUICK_DISTANCE))
        return replace(self, order=replace(order, seconds=QUICK_SECONDS))


@dataclass(frozen=True)
class InTurn:
    """Several walks, one after the other."""

    walks: tuple[Velocity, ...]

    def __call__(self, system: System, seed: int) -> str:
        for each in self.walks:
            if failure := each(system, seed):
                return f"{failure} (after {each.order})"
        return ""

    @property
    def quick(self) -> Self:
        return replace(self, walks=tuple(each.quick for each in self.walks[:2]))


@dataclass(frozen=True)
class Plan:
    """Take the steps of a plan in odom, as ``valorctl step`` does: over ROS and the Footstep Converter."""

    steps: Callable[[], list[PlanStep]]

    def __call__(self, system: System, seed: int) -> str:
        outcome = stepping.step_plan(system.instance, self.steps(), stepping.ODOM, system.observer.hear)
        system.observer.wait(lambda state: state.behavior == "fall", 1.0)
        state = system.observer.state
        return f"{state.behavior}: {state.reason}" if state.behavior == "fall" else outcome.reason

    @property
    def quick(self) -> Self:
        steps = self.steps()
        return replace(self, steps=lambda: steps[: round(QUICK_DISTANCE / STEP)])


@dataclass(frozen=True)
class Pushes:
    """Push the robot again and again, standing or walking by velocity, one direction after the other."""

    impulses: tuple[tuple[float, float], ...]  # one after the other: how much [N·s], from x anticlockwise [rad]
    count: int = 8
    forward: float = 0.0  # walking so meanwhile [m/s]; 0: standing
    every: float = 4.0  # [robot time, s]

    def __call__(self, system: System, seed: int) -> str:
        if self.forward:
            return self._walking(system, seed)
        for k in range(self.count):
            system.push(self._impulse(k))
            if system.observer.wait(lambda state: state.behavior == "fall", self.every):
                return f"fall: {system.observer.state.reason} (push {k + 1}, {self._name(k)})"
        return ""

    def _walking(self, system: System, seed: int) -> str:
        pushed = 0
        start = system.observer.state.time
        first = 5.0 + seed * self.every / 7.0  # at full speed; each seed has phases of its own

        def hear() -> None:
            nonlocal pushed
            system.observer.hear()
            state = system.observer.state
            due = 1e-9 * (state.time - start) > first + pushed * self.every
            if due and pushed < self.count and state.behavior in WALKING:
                system.push(self._impulse(pushed + 3 * seed))
                pushed += 1

        seconds = first + 1.0 + self.count * self.every
        result = walk(system.instance, Order(forward=self.forward, seconds=seconds, straight=True), hear)
        last = self._name(pushed - 1 + 3 * seed)
        return f"{result.reason} (push {pushed}, {last})" if result.reason else ""

    def _impulse(self, k: int) -> tuple[float, float, float]:
        impulse, direction = self.impulses[k % len(self.impulses)]
        return impulse * math.cos(direction), impulse * math.sin(direction), 0.0

    def _name(self, k: int) -> str:
        impulse, direction = self.impulses[k % len(self.impulses)]
        return f"{impulse:g} N·s at {math.degrees(direction):.0f}°"

    @property
    def quick(self) -> Self:
        return replace(self, count=QUICK_PUSHES)


def along_axes(forward: float, back: float, side: float) -> tuple[tuple[float, float], ...]:
    """Impulses for ``Pushes``: forward, back, left, right [N·s]."""
    return (forward, 0.0), (back, math.pi), (side, math.pi / 2), (side, -math.pi / 2)


def all_around(impulse: float, directions: int = 8) -> tuple[tuple[float, float], ...]:
    """Impulses for ``Pushes``: one after another, all around [N·s]."""
    turn = 2.0 * math.pi / directions
    return tuple((impulse, math.remainder(3 * k * turn, 2.0 * math.pi)) for k in range(directions))


@dataclass(frozen=True)
class Stand:
    """Stand still."""

    seconds: float  # [robot time, s]

    def __call__(self, system: System, seed: int) -> str:
        fell = system.observer.wait(lambda state: state.behavior == "fall", self.seconds)
        return f"fall: {system.observer.state.reason}" if fell else ""

    @property
    def quick(self) -> Self:
        return replace(self, seconds=QUICK_SECONDS)


def climb(name: str) -> Callable[[], list[PlanStep]]:
    """Steps over a world of stairs."""

    def steps() -> list[PlanStep]:
        stairs = worlds.WORLDS[name]
        assert isinstance(stairs, Stairs)
        return over_stairs(RobotDescription.load(ROBOT).tables, stairs)

    return steps


def straight_on(distance: float) -> Callable[[], list[PlanStep]]:
    """Steps of one length on a floor taken for flat."""

    def steps() -> list[PlanStep]:
        count = math.ceil(distance / STEP)
        places = [(STANDING[0] + min(distance, (i + 1) * STEP), 0.0) for i in range(count)]
        return _alternating([*places, places[-1]])

    return steps


def _alternating(places: list[tuple[float, float]]) -> list[PlanStep]:
    """Left and right in turn at places (x, z)."""
    y = (STANDING[1], -STANDING[1])
    return [PlanStep(foot="right" if i % 2 else "left", x=x, y=y[i % 2], z=z) for i, (x, z) in enumerate(places)]
