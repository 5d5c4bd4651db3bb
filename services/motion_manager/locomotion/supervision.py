"""Supervision of a controller: faults for which its commands are not executed."""

from __future__ import annotations

import resource
import time
from math import hypot

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import LEGS, Locomotion
from valor.control.controller import Controller, JointCommand, Request
from valor.control.fall import SupportPolygon
from valor.control.state import RobotState
from valor.motion_manager.safety import Stance
from valor.robot.description import RobotDescription

MUTE = 0.05  # duration without a command [s]
STRONGEST = 3.0  # torque that a command asks of a servo, fraction of the joint's limit
PATIENCE = 4.0  # updates longer than their period, or that ask for too much: fewer are tolerated ...
PARDON = 0.5  # ... each for this long [s]
OUTSIDE = 0.02, 0.6  # DCM outside the support polygon, standing and walking, fraction of the leg's length
JOINT_SPEED = 0.25, 1.0  # largest of the legs' joints, standing and walking, fraction of the limit
SPEED = 2.0, 0.5  # largest speed of the pelvis: fraction of the fastest walk, and a constant [m/s]


def servo_torque(command: JointCommand, state: RobotState) -> FloatArray:
    """(n,) what servos make of a command at a state [N·m]."""
    return (
        command.effort
        + command.stiffness * (command.position - state.joint_position)
        + command.damping * (command.velocity - state.joint_velocity)
    )


class Supervised:
    """A controller whose commands are held between its updates, and checked.

    Attributes:
        command: the last one, None before the first.
        fault: reason why its commands are not to be executed; empty without.
        sound: duration for which nothing was wrong [s].
    """

    def __init__(self, robot: RobotDescription, controller: Controller, stance: Stance) -> None:
        tables = robot.tables
        self.controller, self._stance = controller, stance
        self.command: JointCommand | None = None
        self.fault = ""
        self.sound = 0.0
        self._names, self._limit = robot.joints, robot.effort_limit
        self._fastest = SPEED[0] * tables.walking.max_forward_speed + SPEED[1]
        self._legs = np.zeros(len(robot.joints), dtype=bool)
        self._legs[np.concatenate([robot.group_indices(group) for group in LEGS])] = True
        self._joint_speeds = [share * robot.velocity_limit for share in JOINT_SPEED]
        self._outside = [share * tables.size.leg for share in OUTSIDE]
        self._support = SupportPolygon(tables.feet)
        self._ticks = 0
        self._mute = self._complaints = 0.0

    def begin(self, state: RobotState, last: JointCommand | None) -> None:
        """Start the controller from a state; ``last`` is the command in force."""
        self.command, self.fault, self._ticks = None, "", 0
        self.sound = self._mute = self._complaints = 0.0
        try:
            self.controller.begin(state, last)
        except Exception as error:
            self.fault = _text(error)

    def update(self, state: RobotState, request: Request, dt: float) -> JointCommand | None:
        """Command of a period of ``dt`` [s]: a new one, or the last one; None without, and after a fault."""
        self._complaints = max(0.0, self._complaints - dt / PARDON)
        self._mute += dt
        before = self._complaints
        if self._ticks % self.controller.period == 0 and not self.fault:
            self._renew(state, request, self.controller.period * dt)
        self._ticks += 1
        self.fault = self.fault or self._outside_domain(state, request)
        if not self.fault and self._mute > MUTE:
            why = self.controller.refusal(state)
            self.fault = f"no command for {self._mute:.3f} s; expected one within {MUTE} s{why and f': {why}'}"
        self.sound = 0.0 if self.fault or self.command is None or self._complaints > before else self.sound + dt
        return None if self.fault else self.command

    def _renew(self, state: RobotState, request: Request, period: float) -> None:
        began, worked, naps = time.perf_counter(), time.thread_time(), _naps()
        try:
            command = self.controller.update(state, request, period)
        except Exception as error:
            self.fault = _text(error)
            return
        # Time for which other processes had the processor is no fault of the controller.
        took = (time.perf_counter() - began) if _naps() > naps else time.thread_time() - worked
        if command is None:
            return
        self._mute = 0.0
        self.fault = self._malformed(command)
        if self.fault:
            return
        self.command = command
        torque = np.abs(servo_torque(command, state)) / self._limit * self.controller.joints
        worst = int(torque.argmax())
        if torque[worst] > STRONGEST:
            name = self._names[worst]
            self._complain(f"asks {torque[worst]:.1f} times {name}'s effort limit; expected at most {STRONGEST:g}")
        if took > period:
            self._complain(f"took {1e3 * took:.1f} ms; expected at most {1e3 * period:.1f} ms")

    def _complain(self, what: str) -> None:
        self._complaints += 1.0
        if self._complaints >= PATIENCE:
            self.fault = what

    def _malformed(self, command: JointCommand) -> str:
        for name in ("position", "velocity", "effort", "stiffness", "damping"):
            vector = getattr(command, name)
            if np.shape(vector) != self._limit.shape:
                return f"{name} has the shape {np.shape(vector)}; expected {self._limit.shape}"
            if not np.isfinite(vector).all():
                return f"{name} of {self._names[int(np.argmin(np.isfinite(vector)))]} is not finite"
        if (command.stiffness < 0.0).any() or (command.damping < 0.0).any():
            return "stiffness or damping is negative"
        return ""

    def _outside_domain(self, state: RobotState, request: Request) -> str:
        if leaning := self._stance.not_upright(state):
            return leaning
        speed = hypot(*state.pelvis_linear_velocity_in_odom[:2].tolist())
        if speed > self._fastest:
            return f"the pelvis moves at {speed:.2f} m/s; expected at most {self._fastest:.2f} m/s"
        walks = request.locomotion is Locomotion.WALK or self.controller.steps_to_balance
        excess = (np.abs(state.joint_velocity) - self._joint_speeds[walks]) * self._legs
        if excess.max() > 0.0:
            joint = int(excess.argmax())
            limit = self._joint_speeds[walks].item(joint)
            return f"{self._names[joint]} moves at {limit + excess.item(joint):.1f} rad/s; expected at most {limit:.1f}"
        limit = self._outside[walks]
        if (outside := self._support.dcm_outside(state, limit)) is None:
            return ""
        return f"the DCM is {outside:.3f} m outside the support polygon; expected at most {limit:.3f} m"


def _naps() -> int:
    """Number of times that this thread gave the processor away."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
