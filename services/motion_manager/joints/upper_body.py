"""Reference of arms, hands, waist and neck by the states of the Manipulation and Attention FSMs."""

from collections.abc import Collection, Iterable, Mapping
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.behaviors import LEGS, LIMBS, Attention, Locomotion, Manipulation
from valor.motion_manager.joints.joint_reference import JointReference, Setpoint
from valor.robot.description import RobotDescription
from valor.robot.limiter import Joints

SILENCE = 0.2  # timeout without set-points, after which joints that followed them stop [s]
LOST = 0.4  # distance of a joint from its command, at which its limb holds where it is [rad or m]
LOST_TIME = 0.2  # for which it must last, and in which the joint moves further away [s]
LOST_MOVE = 0.04  # by this much; a joint that something blocks does not move [rad or m]
GRACE = 0.05  # from freezing a limb to rejections of its set-points, for clients to stop them [s]
DWELL = 0.3  # delay before slaved arms move home, so that a pair of commands can resolve [s]

JOINT_ACCESS: Mapping[type[StrEnum], tuple[str, ...]] = {
    Locomotion: LEGS,
    Manipulation: ("torso", "left_arm", "right_arm", "left_hand", "right_hand"),
    Attention: ("neck", "lidar"),
}
"""Internal FSM → groups of robot.yaml that it may move."""

SETPOINT_STATES: Mapping[type[StrEnum], StrEnum] = {
    Manipulation: Manipulation.TELEOP,
    Attention: Attention.LOOK,
}
"""Internal FSM → state in which it accepts joint set-points; Locomotion never does."""


def joint_owners(robot: RobotDescription) -> dict[str, type[StrEnum]]:
    """Joint name → the internal FSM that may move it; joints of other groups are missing, and are held."""
    return {
        joint: machine
        for machine, groups in JOINT_ACCESS.items()
        for group in groups
        for joint in robot.tables.groups.get(group, ())
    }


class UpperBody:
    """Moves the reference of the joints that do not carry the robot; ``joints``: internal FSM → (n,) mask of its own.

    Times are robot time [s].
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
        self._received: dict[type[StrEnum], float | None] = {Manipulation: None, Attention: None}
        self._home_at: float | None = None  # start of the move of slaved arms
        # Hands close on objects, which stop them; the lidar turns by itself.
        groups = robot.tables.groups
        unled = [joint for group in ("left_hand", "right_hand", "lidar") for joint in groups.get(group, ())]
        self._led = np.array([joint not in unled for joint in robot.joints])
        self._names = robot.joints
        self._limbs = {limb: robot.group_indices(limb) for limb in LIMBS if groups.get(limb)}
        self.frozen: tuple[str, ...] = ()  # limbs that hold while the rest of the robot moves
        self._frozen_at = 0.0
        self._off: tuple[float, FloatArray] | None = None  # since when joints are off, and where they were then
        self._lost: dict[type[StrEnum], str] = {}  # FSM whose joints left their commands → how far
        self.setpoint_sequence = 0

    @property
    def inconsistent(self) -> Joints:
        """(n,) joints whose acceleration is not fed forward, see ``JointReference``."""
        return self._reference.inconsistent

    def enter(self, manipulation: Manipulation, attention: Attention, now: float) -> None:
        """Apply the states of the internal FSMs; hold the joints of those that change."""
        for machine, state in ((Manipulation, manipulation), (Attention, attention)):
            if state is self._states[machine]:
                continue
            self._states[machine] = state
            self._received[machine] = None
            self._lost.pop(machine, None)
            self._reference.hold(self.joints[machine])
            if machine is Manipulation:
                self._home_at = now + DWELL if state is Manipulation.SLAVE else None

    def freeze(self, limbs: Collection[str], force: Joints, measured: FloatArray, now: float) -> None:
        """Freeze exactly these limbs; (n,) mask ``force``: joints that do so at (n,) ``measured`` positions [rad]."""
        reference, joints = self._reference, np.zeros(len(self._names), dtype=bool)
        for limb in limbs:
            joints[self._limbs[limb]] = True
        new = joints & ~reference.frozen
        reference.take_up(new & force, measured)
        reference.hold(new)
        reference.frozen = joints
        self.frozen, self._frozen_at = tuple(limb for limb in self._limbs if limb in limbs), now
        if self._states[Manipulation] is Manipulation.SLAVE:
            self._home_at = now + DWELL  # of released arms

    def rejection(self, limbs: Iterable[str]) -> str:
        """Reason why limbs cannot be frozen; empty if they can."""
        for limb in limbs:
            if limb not in self._limbs:
                carrying = "the legs carry the robot, and are frozen only with all of it; " if limb in LEGS else ""
                return f"{limb[:64]!r} cannot be frozen: {carrying}expected of {', '.join(self._limbs)}"
        return ""

    def frozen_limb(self, joints: npt.NDArray[np.intp], now: float) -> str:
        """Reason to reject set-points of joints (k,), one of whose limbs is frozen; empty if there is none."""
        if not self.frozen or now - self._frozen_at < GRACE:
            return ""
        return next((f"{limb} is frozen" for limb in self.frozen if np.isin(joints, self._limbs[limb]).any()), "")

    def closed(self, machine: type[StrEnum]) -> str:
        """Reason why joints of an internal FSM accept no set-points; empty if they do."""
        if machine not in SETPOINT_STATES:
            return "they carry the robot"
        if lost := self._lost.get(machine):
            return lost
        state = self._states[machine]
        return "" if state is SETPOINT_STATES[machine] else f"{machine.__name__.lower()} is {state}"

    def follow(self, machines: Iterable[type[StrEnum]], setpoint: Setpoint, now: float, sequence: int) -> None:
        """Follow a checked set-point for joints of ``machines``; ``sequence`` is that of the JointSetpoints."""
        self.setpoint_sequence = sequence
        for machine in machines:
            self._received[machine] = now
        self._reference.follow(setpoint)

    def update(self, measured: FloatArray, now: float) -> None:
        """Hold joints whose set-points timed out or that left them, and start the move home of slaved arms.

        Args:
            measured: (n,) joint positions [rad or m].
            now: robot time [s].
        """
        self._watch(measured, now)
        for machine, received in self._received.items():
            if received is not None and now - received > SILENCE:
                self._received[machine] = None
                self._reference.hold(self.joints[machine])
        if self._home_at is not None and now >= self._home_at:
            self._home_at = None
            self._reference.move(self.joints[Manipulation], self._nominal, now)

    def _watch(self, measured: FloatArray, now: float) -> None:
        """Hold joints that follow set-points where they are, if one moves away from its command, beyond ``LOST``."""
        led = [machine for machine, received in self._received.items() if received is not None]
        away = measured - self._reference.position
        off = np.where(self._led & ~self._reference.frozen, np.abs(away), 0.0)
        if not any((off[self.joints[machine]] > LOST).any() for machine in led):
            self._off = None
            return
        if self._off is None:
            self._off = now, measured.copy()
        since, before = self._off
        if now - since < LOST_TIME:
            return
        self._off = None
        off[(measured - before) * np.sign(away) < LOST_MOVE] = 0.0
        for machine in led:
            joint = int(np.argmax(np.where(self.joints[machine], off, 0.0)))
            if off[joint] > LOST:
                self._lost[machine] = (
                    f"{self._names[joint]} was {off[joint]:.2f} away from its command; expected at most {LOST:g}. "
                    "The joints hold where they were; change the control mode to move them again"
                )
                self._received[machine] = None
                self._reference.take_up(self.joints[machine] & ~self._reference.frozen, measured)
