"""What the robot does when a cable goes out, and what it is sent meanwhile. For ``cables``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from valor.common.resources import robot_folder
from valor.common.topics import HAND_GOAL, VELOCITY
from valor.robot.description import RobotDescription

ASIDE, BACK = 0.3, -0.3  # of the left arm's last joint, before and in the cut [rad]
LOW, HIGH = 0.05, 0.2  # of the left hand over the pelvis, likewise [m]
LATE_PLAN = 100  # index of the first step of the plan sent in the cut
SPEED, LATE_SPEED = 0.15, 0.151  # before and in the cut [m/s]

_ROBOT = RobotDescription.load(robot_folder("escher"))
_JOINT = _ROBOT.index[_ROBOT.tables.group("left_arm")[-1]]


@dataclass(frozen=True)
class Case:
    """A behavior, and who tells of what is sent while the cable is out that it was obeyed."""

    name: str
    mode: str
    begin: str  # the operator's line that begins it; empty: the mode is all
    late: str  # the line sent while the cable is out
    obeyed: Callable[[dict[str, Any]], bool]  # whether a tap's word shows that it was, or that it arrived
    begun: Callable[[dict[str, Any]], bool] | None = None  # the same of the line that begins it
    topic: str = ""  # on which it arrives at the Motion Manager, which may refuse it
    repeated: bool = False


def _behavior(name: str) -> Callable[[dict[str, Any]], bool]:
    return lambda event: event.get("behavior") == name


def _is(kind: str, value: float) -> Callable[[dict[str, Any]], bool]:
    return lambda event: bool(event["kind"] == kind and event["value"] == value)


def _aside(event: dict[str, Any]) -> bool:
    return event["kind"] == "state" and float(event["setpoint"][_JOINT]) > 0.1 * ASIDE


def _back(event: dict[str, Any]) -> bool:
    return event["kind"] == "state" and float(event["setpoint"][_JOINT]) < 0.5 * BACK


def _step(event: dict[str, Any]) -> bool:
    return bool(event["kind"] == "step")


def _late_step(event: dict[str, Any]) -> bool:
    return bool(event["kind"] == "step" and event["value"] >= LATE_PLAN)


_SPEEDS = _is("velocity", LATE_SPEED), _is("velocity", SPEED)
_HANDS = _is("hand", HIGH), _is("hand", LOW)
_BESIDE, _STEPS = f"arm {ASIDE} 6", "steps 0 12"

CASES = (
    Case("standing", "stand", "", "mode stand_manipulate", _behavior("stand_manipulate")),
    Case("walking", "walk", f"velocity {SPEED}", f"velocity {LATE_SPEED}", *_SPEEDS, VELOCITY.name, repeated=True),
    Case("stepping", "step", _STEPS, f"steps {LATE_PLAN} 4", _late_step, _step),
    Case("trajectory", "stand_manipulate", _BESIDE, f"arm {BACK} 3", _back, _aside),
    Case("hand goal", "stand_manipulate", f"hand {LOW}", f"hand {HIGH}", *_HANDS, HAND_GOAL.name),
    Case("frozen", "freeze", "", "mode stand_prep", _behavior("stand_prep")),
    Case("action: mode", "stand", "", "goal mode stand_manipulate", _behavior("stand_manipulate")),
    Case("action: steps", "step", _STEPS, f"goal steps {LATE_PLAN} 4", _late_step, _step),
    Case("action: arm", "stand_manipulate", _BESIDE, f"goal arm {BACK} 3", _back, _aside),
)
"""The last three are sent as goals of actions."""
