"""Walking at a velocity for a while, and how well it went."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import bifrost
from valor_common.errors import ValorError
from valor_common.instance import Instance
from valor_common.messages import MotionState, VelocityCommand
from valor_common.topics import MOTION_STATE, VELOCITY
from valorctl import control_mode

MODES = ("walk", "walk_manipulate")
PERIOD = 0.05  # between commands [s]
REST_SPEED = 0.02  # of a pelvis at rest [m/s]
REST_DURATION = 0.5  # for which it must be [robot time, s]
LONGEST_STOP = 20.0  # [robot time, s]
SILENCE = 5.0  # of the Motion Manager, after which it is given up [s]


@dataclass(frozen=True)
class Walk:
    """What became of a walk, as the robot itself believes."""

    distance: float  # of the pelvis, from where it began to where it came to rest [m]
    duration: float  # until rest [robot time, s]
    fell: bool
    reason: str  # of leaving Walk, if it did
    dcm_error: float  # mean distance of the DCM from its reference [m]

    def describe(self) -> str:
        """One line."""
        return f"{self.distance:.2f} m in {self.duration:.1f} s, mean DCM error {self.dcm_error * 1e3:.1f} mm"


def walk(instance: Instance, velocity: tuple[float, float, float], seconds: float, check: Callable[[], None]) -> Walk:
    """Go to mode ``walk``, walk, stop, and go back to the mode before.

    Args:
        instance: a running system.
        velocity: forward, left [m/s], turning [rad/s].
        seconds: of robot time.
        check: raises when the user wants to stop; the robot then stops by itself.

    Raises:
        ValorError: not finite, mode refused, or nobody answers.
    """
    if not all(map(math.isfinite, (*velocity, seconds))):
        raise ValorError(f"velocity {velocity} for {seconds} s: expected finite numbers")
    before = control_mode.report(instance).current_control_mode
    if before not in MODES:
        _change(instance, "walk", check)
    network = bifrost.Network.load(instance.network_file, instance.keys)
    with bifrost.Node("valorctl", network=network) as node:
        result = _walk(node, velocity, seconds, check)
    if before not in MODES and not result.reason:
        _change(instance, before, check)
    return result


def _change(instance: Instance, mode: str, check: Callable[[], None]) -> None:
    change = control_mode.change(instance, mode, check=check)
    if not change.reached:
        raise ValorError(change.describe())


def _walk(node: bifrost.Node, velocity: tuple[float, float, float], seconds: float, check: Callable[[], None]) -> Walk:
    states = node.subscriber(MOTION_STATE.name, MotionState, queue=5000)
    commands = node.publisher(VELOCITY.name, VelocityCommand)
    x, y, turn = velocity
    began: MotionState | None = None
    errors: list[float] = []
    moving, heard = 0, time.monotonic()  # robot time at which the pelvis moved last
    while True:
        check()
        received = [each.message for each in states.drain()]
        if not received:
            if time.monotonic() - heard > SILENCE:
                raise ValorError(f"{MOTION_STATE.name} is silent for {SILENCE:g} s: see `valorctl status`")
            time.sleep(0.5 * PERIOD)
            continue
        heard, state = time.monotonic(), received[-1]
        began = began or received[0]
        for each in received:
            errors.append(float(np.linalg.norm(each.dcm_in_odom - each.dcm_reference_in_odom)))
            if np.linalg.norm(each.pelvis_linear_velocity_in_odom) > REST_SPEED:
                moving = each.time
        passed = 1e-9 * (state.time - began.time)
        walking = state.behavior in MODES
        rested = passed > seconds + 1.0 and 1e-9 * (state.time - moving) > REST_DURATION
        if not walking or rested or passed > seconds + LONGEST_STOP:
            way = state.pelvis_position_in_odom - began.pelvis_position_in_odom
            return Walk(
                distance=float(np.hypot(way[0], way[1])),
                duration=passed,
                fell=state.behavior == "fall",
                reason="" if walking else f"{state.behavior}: {state.reason}",
                dcm_error=float(np.mean(errors)),
            )
        if passed < seconds:
            commands.publish(VelocityCommand(time=state.time, linear_x=x, linear_y=y, angular_z=turn))
        time.sleep(PERIOD)
