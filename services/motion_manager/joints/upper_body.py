"""Arms, hands, waist and neck as the Manipulation and Attention FSMs have them: locked, slaved, or led from outside."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from valor.common.behaviors import Attention, Locomotion, Manipulation
from valor.motion_manager.joints.joint_reference import JointReference, Setpoint
from valor.motion_manager.states.transitions import SETPOINT_STATES, joint_owners
from valor.robot.description import RobotDescription
from valor.robot.limiter import Joints

SILENCE = 0.2  # without set-points for so long, joints that followed them stop [s]
DWELL = 0.3  # slaved arms stay so long before they go home, so that a pair of commands can resolve [s]


class UpperBody:
    """Moves the reference of the joints that do not carry the robot. Times are robot time [s].

    Attributes:
        owners: joint name → the internal FSM that may move it; those that none may are held.
        joints: internal FSM → (n,) which joints are its own.
    """

    def __init__(self, robot: RobotDescription, reference: JointReference) -> None:
        self.owners = joint_owners(robot)
        self._reference = reference
        self._nominal = robot.nominal_posture
        self.joints: dict[type[StrEnum], Joints] = {
            machine: np.array([self.owners.get(joint) is machine for joint in robot.joints])
            for machine in (Locomotion, Manipulation, Attention)
        }
        self._states: dict[type[StrEnum], StrEnum] = {
            Manipulation: Manipulation.LOCKED,
            Attention: Attention.LOCKED,
        }
        self._heard: dict[type[StrEnum], float | None] = {Manipulation: None, Attention: None}
        self._home_at: float | None = None  # when slaved arms set out
        self.setpoint_sequence = 0  # of the JointSetpoints followed last

    def enter(self, manipulation: Manipulation, attention: Attention, now: float) -> None:
        """The internal FSMs are in these states from now on; staying in one changes nothing."""
        for machine, state in ((Manipulation, manipulation), (Attention, attention)):
            if state is self._states[machine]:
                continue
            self._states[machine] = state
            self._heard[machine] = None
            self._reference.hold(self.joints[machine])
            if machine is Manipulation:
                self._home_at = now + DWELL if state is Manipulation.SLAVE else None

    def closed(self, machine: type[StrEnum]) -> str:
        """Why joints of an internal FSM accept no set-points; an empty text: they do."""
        if machine not in SETPOINT_STATES:
            return "they carry the robot"
        state = self._states[machine]
        return "" if state is SETPOINT_STATES[machine] else f"{machine.__name__.lower()} is {state}"

    def follow(self, machines: frozenset[type[StrEnum]], setpoint: Setpoint, now: float, sequence: int) -> None:
        """Follow a set-point that has been checked, of joints of these machines, the JointSetpoints of a sequence."""
        self.setpoint_sequence = sequence
        for machine in machines:
            self._heard[machine] = now
        self._reference.follow(setpoint)

    def update(self, now: float) -> None:
        """Before the reference advances: stop what has gone silent, send slaved arms home."""
        for machine, heard in self._heard.items():
            if heard is not None and now - heard > SILENCE:
                self._heard[machine] = None
                self._reference.hold(self.joints[machine])
        if self._home_at is not None and now >= self._home_at:
            self._home_at = None
            self._reference.move(self.joints[Manipulation], self._nominal, now)
