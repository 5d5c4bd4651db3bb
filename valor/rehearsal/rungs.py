"""The rungs: what a robot does before it is taken to a system, each with a limit that a sound one keeps by far.

All lengths go with the leg, all impulses with the mass: the same rungs for 3 and for 180 kg.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.common.poses import Pose, level
from valor.rehearsal.legs import Legs
from valor.rehearsal.plan_walk import take_plan
from valor.rehearsal.watch import Numbers, WatchedLoop
from valor.robot.checks import SIDES
from valor.robot.description import RobotDescription
from valor.simulation.plant import SimulationDivergedError
from valor.whole_body.walking.velocity_steps import VelocitySteps

PROFILES = ("ideal", "hardware")
PASSIVE = 2.0  # on the servos alone [s]
STAND = 4.0  # [s]
REACH = 1.5  # of an arm to a preset; as long again it rests there [s]
IMPULSE = 10.0 / 50.0  # of a push, of the robot's mass [N·s/kg]
PUSH, RECOVERY = 0.1, 3.0  # of a push, and after it [s]
WALK = 10.0  # [s]
SPEED, LEG = 0.25, 0.86  # of a walk [m/s], by a leg of [m]: at the same Froude number for all
STRIDE = 0.2  # of a planned step, by such a leg [m]
STEPS = 6
STOP = 4.0  # that a walk may take to end [s]

_TILT = 0.15  # that a standing robot may lean [rad]
_SAG = 0.05  # that it may sink, of its base's height
_ARM = 0.05  # that an arm may be away from where it was sent [rad]
_DCM = 0.5  # of its error, RMS, of a sole's half width
_CALM = 0.5  # likewise, of what is left of it after a push
_PLACE = 0.04  # of a foot's place after a plan, by such a leg [m]
_WAY = (0.6, 1.3)  # of a walk's length, of what was asked

DIRECTIONS = {
    "forward": (1.0, 0.0, 0.0),
    "backward": (-1.0, 0.0, 0.0),
    "left": (0.0, 1.0, 0.0),
    "right": (0.0, -1.0, 0.0),
}


@dataclass(frozen=True)
class Rung:
    """How one went.

    Attributes:
        name: of the rung.
        reason: why it failed, or empty.
        numbers: what was seen; None where it was not tried.
        told: what the rung itself measured, for people.
    """

    name: str
    reason: str
    numbers: Numbers | None = None
    told: str = ""

    @property
    def passed(self) -> bool:
        """Whether it held."""
        return not self.reason

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        numbers = None if self.numbers is None else self.numbers.plain()
        return {"name": self.name, "passed": self.passed, "reason": self.reason, "told": self.told, "numbers": numbers}


@dataclass(frozen=True)
class _Step:
    """A planned step, as the robot itself would take it."""

    foot: str
    sole: Pose
    swing_height: float = 0.0
    step_duration: float = 0.0
    sway_duration: float = 0.0


class Rehearsal:
    """A robot, played under one actuator profile."""

    def __init__(self, robot: RobotDescription, profile: str) -> None:
        self._robot = robot
        self._profile = profile
        self._legs = Legs(robot)
        self._size = self._legs.length / LEG
        feet = robot.tables.feet
        self._half_width = min(feet.left.half_width, feet.right.half_width)

    def rungs(self) -> Iterator[tuple[str, Callable[[], Rung]]]:
        """The name of each, and what plays it."""
        played: list[tuple[str, Callable[[WatchedLoop], tuple[str, str]], float]] = [
            ("passive", self._passive, 0.0),
            (Behavior.STAND, self._stand, 0.0),
            *((f"arm {preset}", self._reach(preset), 1.0) for preset in self._preset()),
            *((f"push {name}", self._push(direction), 2.0) for name, direction in DIRECTIONS.items()),
            *((("six steps", self._plan, 2.0),) if self._robot.tables.footsteps is not None else ()),
            (Behavior.WALK, self._walk, 1.5),
        ]
        for name, play, before in played:
            yield name, lambda name=name, play=play, before=before: self._played(name, play, before)  # type: ignore[misc]

    def _played(self, name: str, play: Callable[[WatchedLoop], tuple[str, str]], before: float) -> Rung:
        """One rung, of a robot that has stood under control for some time [s], if any."""
        loop = WatchedLoop(self._robot, self._legs, self._profile)
        try:
            if before:
                loop.settle(0.3)
                loop.run(before)
                loop.begin()
            reason, told = play(loop)
        except SimulationDivergedError as error:
            return Rung(name, str(error), loop.numbers())
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            return Rung(name, f"{type(error).__name__}: {error}", loop.numbers())
        numbers = loop.numbers()
        reason = loop.fall or reason
        if not reason and numbers.unsolved:
            reason = f"the QP had no solution in {numbers.unsolved} periods"
        return Rung(name, reason, numbers, told)

    def _upright(self, loop: WatchedLoop) -> str:
        height, nominal = float(loop.plant.data.qpos[2]), self._robot.tables.nominal_base_height
        if loop.tilt > _TILT:
            return f"leans {loop.tilt:.2f} rad; expected at most {_TILT}"
        if abs(height - nominal) > _SAG * nominal:
            return f"the base is {height:.3f} m high; expected {nominal:.3f}"
        return ""

    def _passive(self, loop: WatchedLoop) -> tuple[str, str]:
        for _ in range(round(PASSIVE / 0.1)):
            loop.settle(0.1)
        return self._upright(loop), f"height {loop.plant.data.qpos[2]:.3f} m"

    def _stand(self, loop: WatchedLoop) -> tuple[str, str]:
        loop.settle(0.3)
        loop.run(STAND)
        return self._upright(loop), f"height {loop.plant.data.qpos[2]:.3f} m"

    def _preset(self) -> list[str]:
        """The arm preset to reach: the one farthest from the nominal posture; none where there are no arms."""
        robot = self._robot

        def way(preset: str) -> float:
            joints = [pair for posture in robot.tables.arm_presets[preset].values() for pair in posture.items()]
            return sum(abs(angle - float(robot.nominal_posture[robot.index[name]])) for name, angle in joints)

        return sorted(robot.tables.arm_presets, key=way)[-1:]

    def _reach(self, preset: str) -> Callable[[WatchedLoop], tuple[str, str]]:
        def play(loop: WatchedLoop) -> tuple[str, str]:
            sides = self._robot.tables.arm_presets[preset]
            goal = {name: angle for side in SIDES for name, angle in sides.get(side, {}).items()}  # type: ignore[call-overload]
            arms = np.array([self._robot.index[name] for name in goal], dtype=np.intp)
            self._lead(loop, arms, np.array(list(goal.values())))
            loop.run(REACH)
            errors = np.abs(loop.plant.joint_position[arms] - loop.reference.position[arms])
            worst = int(np.argmax(errors))
            told = f"{self._robot.joints[arms[worst]]} {errors[worst]:.3f} rad off"
            return (f"{told}; expected at most {_ARM}" if errors[worst] > _ARM else ""), told

        return play

    @staticmethod
    def _lead(loop: WatchedLoop, joints: Any, goal: FloatArray) -> None:
        """Lead joints to a (k,) goal by a polynomial without jerks, no faster than half their velocity limits."""
        reference, start = loop.reference, loop.reference.position[joints].copy()
        speed = loop.robot.velocity_limit[joints]
        duration = max(REACH, float((1.875 * np.abs(goal - start) / (0.5 * speed)).max(initial=0.0)))
        began = loop.time
        while (share := (loop.time - began) / duration) < 1.0 and loop.fall is None:
            reference.position[joints] = start + (10 - 15 * share + 6 * share**2) * share**3 * (goal - start)
            reference.velocity[joints] = 30 * (1 - share) ** 2 * share**2 * (goal - start) / duration
            loop.step()
        reference.position[joints], reference.velocity[joints] = goal, 0.0

    def _push(self, direction: tuple[float, float, float]) -> Callable[[WatchedLoop], tuple[str, str]]:
        def play(loop: WatchedLoop) -> tuple[str, str]:
            mj = loop.plant.model.mj
            mass = float(mj.body_subtreemass[loop.plant.model.body(self._robot.tables.base)])
            loop.plant.push(IMPULSE * mass * np.array(direction), PUSH)
            stepped = False
            until = loop.time + RECOVERY
            while loop.time < until and loop.fall is None:
                loop.step()
                stepped = stepped or loop.controller.stepping
            error = np.hypot(*(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)[:2])
            told = f"{IMPULSE * mass:.1f} N·s" + (", by a step" if stepped else "")
            limit = _CALM * self._half_width
            return (f"the DCM still swings by {error:.3f} m" if error > limit else ""), told

        return play

    def _plan(self, loop: WatchedLoop) -> tuple[str, str]:
        tables = self._robot.tables
        assert tables.footsteps is not None
        half, farthest = tables.walking.step_width / 2, 0.95 * tables.footsteps.max_distance
        reach = math.sqrt(max(0.0, farthest**2 - (2 * half) ** 2))
        stride = min(STRIDE * self._size, 0.9 * tables.footsteps.max_forward, reach)
        places = [stride * min(i, STEPS - 1) for i in range(1, STEPS + 1)]
        steps = [_Step(SIDES[i % 2], level(x, half if i % 2 == 0 else -half, 0.0, 0.0)) for i, x in enumerate(places)]
        walked = take_plan(loop, steps)
        if walked.refusal:
            return f"the plan was refused: {walked.refusal}", ""
        if loop.fall is None and not math.isfinite(walked.believed[0]):
            return "the plan did not come to its end", ""
        told = f"feet {walked.true[0] * 1e3:.0f} mm off"
        limit = _PLACE * self._size
        return (f"{told}; expected at most {limit * 1e3:.0f}" if walked.true[0] > limit else ""), told

    def _walk(self, loop: WatchedLoop) -> tuple[str, str]:
        speed = min(SPEED * math.sqrt(self._size), self._robot.tables.walking.max_forward_speed)
        loop.controller.step_source = source = VelocitySteps(self._robot.tables.walking)
        began = loop.time
        while loop.fall is None and (loop.time < began + WALK or loop.controller.stepping):
            if loop.time < began + WALK:
                source.command(np.array((speed, 0.0, 0.0)), loop.time)
            source.advance(loop.time)
            loop.step()
            if loop.time > began + WALK + STOP:
                return "does not come to rest", ""
        seen = loop.numbers()
        asked = speed * WALK
        told = f"{seen.distance:.2f} m of {asked:.2f}, {speed:.2f} m/s"
        if not _WAY[0] * asked < seen.distance < _WAY[1] * asked:
            return f"walked {told}", told
        if seen.dcm_error is not None and seen.dcm_error > _DCM * self._half_width:
            return f"the DCM swings by {seen.dcm_error * 1e3:.0f} mm", told
        return "", told
