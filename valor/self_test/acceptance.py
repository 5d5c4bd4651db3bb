"""Acceptance tests of a robot, each with a limit that a valid robot keeps by a wide margin.

Lengths scale with the leg and impulses with the mass: the same tests hold for 3 kg and for 180 kg.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.robot.description import RobotDescription
from valor.robot.step_plan import FEET, PlanStep
from valor.robot.tables import SIDES
from valor.self_test.closed_loop import MeasuredLoop, leg_length
from valor.self_test.plan_walk import take_plan
from valor.self_test.results import AcceptanceResult
from valor.simulation.plant import Plant, SimulationDivergedError
from valor.whole_body.walking.velocity_steps import VelocitySteps

PASSIVE = 2.0  # on the servos only [s]
STAND = 4.0  # [s]
REACH = 1.5  # motion of an arm to a preset, and rest there [s]
IMPULSE = 10.0 / 50.0  # of a push, by the robot's mass [N·s/kg]
PUSH, RECOVERY = 0.1, 3.0  # duration of a push, and time after it [s]
WALK = 10.0  # [s]
SPEED, LEG = 0.25, 0.86  # of a walk [m/s] with a leg of [m]; at the same Froude number for all
STRIDE = 0.2  # of a planned step with such a leg [m]
STEPS = 6
STOP = 4.0  # time to end a walk [s]

_TILT = 0.15  # tilt of a standing robot, at most [rad]
_SAG = 0.05  # sinking, at most, share of the base's height
_ARM = 0.05  # error of an arm, at most [rad]
_DCM = 0.5  # RMS error, at most, share of a sole's half width
_CALM = 0.5  # error after a push, at most, share of a sole's half width
_PLACE = 0.04  # error of a foot after a plan, at most, with such a leg [m]
_WAY = (0.6, 1.3)  # length of a walk, share of the requested length

DIRECTIONS = {
    "forward": (1.0, 0.0, 0.0),
    "backward": (-1.0, 0.0, 0.0),
    "left": (0.0, 1.0, 0.0),
    "right": (0.0, -1.0, 0.0),
}


def push_impulse(plant: Plant) -> float:
    """Return the impulse of a push, by the robot's mass [N·s]."""
    model = plant.model
    return IMPULSE * float(model.mj.body_subtreemass[model.body(model.robot.tables.base)])


def walking_speed(robot: RobotDescription) -> float:
    """Return the speed of a walk, by the robot's legs [m/s]."""
    return min(SPEED * math.sqrt(leg_length(robot) / LEG), robot.tables.walking.max_forward_speed)


class SelfTest:
    """The acceptance tests of a robot under one actuator profile."""

    def __init__(self, robot: RobotDescription, profile: str) -> None:
        self._robot = robot
        self._profile = profile
        self._size = leg_length(robot) / LEG
        feet = robot.tables.feet
        self._half_width = min(feet.left.half_width, feet.right.half_width)

    def tests(self) -> Iterator[tuple[str, Callable[[], AcceptanceResult]]]:
        """Name and function of each test."""
        tests: list[tuple[str, Callable[[MeasuredLoop], tuple[str, str]], float]] = [
            ("passive", self._passive, 0.0),
            (Behavior.STAND, self._stand, 0.0),
            *((f"arm {preset}", self._reach(preset), 1.0) for preset in self._preset()),
            *((f"push {name}", self._push(direction), 2.0) for name, direction in DIRECTIONS.items()),
            *((("six steps", self._plan, 2.0),) if self._robot.tables.footsteps is not None else ()),
            (Behavior.WALK, self._walk, 1.5),
        ]
        for name, test, before in tests:
            yield name, lambda name=name, test=test, before=before: self._run(name, test, before)  # type: ignore[misc]

    def _run(self, name: str, test: Callable[[MeasuredLoop], tuple[str, str]], before: float) -> AcceptanceResult:
        """Run one test, after standing under control for ``before`` [s]."""
        loop = MeasuredLoop(self._robot, self._profile)
        try:
            if before:
                loop.settle(0.3)
                loop.run(before)
                loop.begin()
            reason, measured = test(loop)
        except SimulationDivergedError as error:
            return self._result(name, str(error), loop)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            return self._result(name, f"{type(error).__name__}: {error}", loop)
        reason = loop.fall or reason
        if not reason and (unsolved := loop.measurements().unsolved):
            reason = f"the QP had no solution in {unsolved} periods"
        return self._result(name, reason, loop, measured)

    def _result(self, name: str, reason: str, loop: MeasuredLoop, measured: str = "") -> AcceptanceResult:
        return AcceptanceResult(self._profile, name, not reason, reason, measured, loop.measurements())

    def _upright(self, loop: MeasuredLoop) -> str:
        height, nominal = float(loop.plant.data.qpos[2]), self._robot.tables.nominal_base_height
        if loop.tilt > _TILT:
            return f"leans {loop.tilt:.2f} rad; expected at most {_TILT}"
        if abs(height - nominal) > _SAG * nominal:
            return f"the base is {height:.3f} m high; expected {nominal:.3f}"
        return ""

    def _passive(self, loop: MeasuredLoop) -> tuple[str, str]:
        for _ in range(round(PASSIVE / 0.1)):
            loop.settle(0.1)
        return self._upright(loop), f"height {loop.plant.data.qpos[2]:.3f} m"

    def _stand(self, loop: MeasuredLoop) -> tuple[str, str]:
        loop.settle(0.3)
        loop.run(STAND)
        return self._upright(loop), f"height {loop.plant.data.qpos[2]:.3f} m"

    def _preset(self) -> list[str]:
        """The arm preset farthest from the nominal posture, in a list; empty without arms."""
        robot = self._robot

        def way(preset: str) -> float:
            joints = [pair for posture in robot.tables.arm_presets[preset].values() for pair in posture.items()]
            return sum(abs(angle - float(robot.nominal_posture[robot.index[name]])) for name, angle in joints)

        return sorted(robot.tables.arm_presets, key=way)[-1:]

    def _reach(self, preset: str) -> Callable[[MeasuredLoop], tuple[str, str]]:
        def test(loop: MeasuredLoop) -> tuple[str, str]:
            sides = self._robot.tables.arm_presets[preset]
            goal = {name: angle for side in SIDES for name, angle in sides.get(side, {}).items()}  # type: ignore[call-overload]
            arms = np.array([self._robot.index[name] for name in goal], dtype=np.intp)
            self._lead(loop, arms, np.array(list(goal.values())))
            loop.run(REACH)
            errors = np.abs(loop.plant.joint_position[arms] - loop.reference.position[arms])
            worst = int(np.argmax(errors))
            measured = f"{self._robot.joints[arms[worst]]} {errors[worst]:.3f} rad off"
            return (f"{measured}; expected at most {_ARM}" if errors[worst] > _ARM else ""), measured

        return test

    @staticmethod
    def _lead(loop: MeasuredLoop, joints: Any, goal: FloatArray) -> None:
        """Move joints to a (k,) goal along a quintic, at most at half their velocity limits."""
        reference, start = loop.reference, loop.reference.position[joints].copy()
        speed = loop.robot.velocity_limit[joints]
        duration = max(REACH, float((1.875 * np.abs(goal - start) / (0.5 * speed)).max(initial=0.0)))
        began = loop.time
        while (share := (loop.time - began) / duration) < 1.0 and loop.fall is None:
            reference.position[joints] = start + (10 - 15 * share + 6 * share**2) * share**3 * (goal - start)
            reference.velocity[joints] = 30 * (1 - share) ** 2 * share**2 * (goal - start) / duration
            loop.step()
        reference.position[joints], reference.velocity[joints] = goal, 0.0

    def _push(self, direction: tuple[float, float, float]) -> Callable[[MeasuredLoop], tuple[str, str]]:
        def test(loop: MeasuredLoop) -> tuple[str, str]:
            impulse = push_impulse(loop.plant)
            loop.plant.push(impulse * np.array(direction), PUSH)
            stepped = False
            until = loop.time + RECOVERY
            while loop.time < until and loop.fall is None:
                loop.step()
                stepped = stepped or not loop.controller.at_rest
            error = np.hypot(*(loop.state.dcm_in_odom - loop.command.dcm_reference_in_odom)[:2])
            measured = f"{impulse:.1f} N·s" + (", by a step" if stepped else "")
            limit = _CALM * self._half_width
            return (f"the DCM still swings by {error:.3f} m" if error > limit else ""), measured

        return test

    def _plan(self, loop: MeasuredLoop) -> tuple[str, str]:
        tables = self._robot.tables
        assert tables.footsteps is not None
        half, farthest = tables.walking.step_width / 2, 0.95 * tables.footsteps.max_distance
        reach = math.sqrt(max(0.0, farthest**2 - (2 * half) ** 2))
        stride = min(STRIDE * self._size, 0.9 * tables.footsteps.max_forward, reach)
        places = [stride * min(i, STEPS - 1) for i in range(1, STEPS + 1)]
        steps = [PlanStep(foot=FEET[i % 2], x=x, y=half if i % 2 == 0 else -half) for i, x in enumerate(places)]
        walked = take_plan(loop, steps)
        if walked.refusal:
            return f"the plan was refused: {walked.refusal}", ""
        if loop.fall is None and not math.isfinite(walked.believed[0]):
            return "the plan did not come to its end", ""
        measured = f"feet {walked.true[0] * 1e3:.0f} mm off"
        limit = _PLACE * self._size
        return (f"{measured}; expected at most {limit * 1e3:.0f}" if walked.true[0] > limit else ""), measured

    def _walk(self, loop: MeasuredLoop) -> tuple[str, str]:
        speed = walking_speed(self._robot)
        loop.request.steps = source = VelocitySteps(self._robot.tables.walking)
        began = loop.time
        while loop.fall is None and (loop.time < began + WALK or not loop.controller.at_rest):
            if loop.time < began + WALK:
                source.command(np.array((speed, 0.0, 0.0)), loop.time)
            source.advance(loop.time)
            loop.step()
            if loop.time > began + WALK + STOP:
                return "does not come to rest", ""
        seen = loop.measurements()
        asked = speed * WALK
        measured = f"{seen.distance:.2f} m of {asked:.2f}, {speed:.2f} m/s"
        if not _WAY[0] * asked < seen.distance < _WAY[1] * asked:
            return f"walked {measured}", measured
        if seen.dcm_error is not None and seen.dcm_error > _DCM * self._half_width:
            return f"the DCM swings by {seen.dcm_error * 1e3:.0f} mm", measured
        return "", measured
