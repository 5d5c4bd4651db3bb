"""Preview of goals of arms and hands: posture, limits, collisions and balance.

Contacts of the nominal posture do not count as collisions. Balance is static.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.operator_station.scene.body import Body
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.model import Model
from valor.robot.soles import distance_outside
from valor.robot.tables import Side

ON_THE_WAY = 12  # postures checked on the path
BALANCE = 0.02  # least distance of the centre of mass from the edge of the soles [m]
REACH = (0.01, 0.1)  # largest distance of a hand from its goal [m, rad]
_ROUNDS, _DAMPING, _STRIDE = 150, 0.05, 0.3  # inverse kinematics: iterations, λ, largest step [rad]


@dataclass(frozen=True)
class Preview:
    """Final joint positions by name [rad], and the reasons for rejection."""

    joints: Mapping[str, float]
    faults: Sequence[str]


class Previewer:
    """Checks goals for one robot; used from one thread."""

    def __init__(self, model: Model) -> None:
        """``model`` has all joints and collision shapes."""
        self._body = Body(model)
        self._limits = CommandedLimits.of_joints(model.robot)
        self._resting = self._touching()

    def arm(self, now: Body, goal: Mapping[str, float], contacts: Sequence[bool]) -> Preview:
        """Preview joint positions [rad] from a posture."""
        robot = self._body.model.robot
        faults = []
        for name, angle in goal.items():
            place = robot.index[name]
            lower, upper = self._limits.lower[place], self._limits.upper[place]
            if not lower <= angle <= upper:
                faults.append(f"limits: {name} {angle:.2f} rad; expected {lower:.2f} to {upper:.2f}")
        faults += self._collisions(now, goal)
        self._body.like(now)
        self._body.bend(goal)
        self._body.update()
        x, y, _ = self._body.com().tolist()
        support = self._body.support(contacts)
        inside = -distance_outside(support, x, y) if support else -np.inf
        if inside < BALANCE:
            where = f"{100.0 * inside:.1f} cm inside the soles" if support else "with no sole on the ground"
            faults.append(f"balance: the centre of mass would be {where}; expected at least {100.0 * BALANCE:g} cm")
        return Preview(dict(goal), faults)

    def hand(self, now: Body, side: Side, position: FloatArray, turn: FloatArray, contacts: Sequence[bool]) -> Preview:
        """Preview a hand's pose in odom: (3,) [m], (3, 3)."""
        joints, distance, angle = self._reach(now, side, position, turn)
        preview = self.arm(now, joints, contacts)
        if distance <= REACH[0] and angle <= REACH[1]:
            return preview
        short = (
            f"reach: the {side} hand would stay {100.0 * distance:.1f} cm and {np.degrees(angle):.0f}° from its goal"
        )
        return Preview(joints, [short, *preview.faults])

    def _reach(
        self, now: Body, side: Side, position: FloatArray, turn: FloatArray
    ) -> tuple[dict[str, float], float, float]:
        """Damped least squares: nearest arm joints [rad], and their distance from the goal [m, rad]."""
        body, model = self._body, self._body.model
        robot = model.robot
        hand = getattr(robot.tables.hands, side)
        site = model.site(hand.site)
        names = robot.tables.group(f"{side}_arm")
        places = robot.group_indices(f"{side}_arm")
        dofs = np.array([model.mj.joint(name).dofadr[0] for name in names])
        limits = self._limits.select(places)
        body.like(now)
        jacobian = np.zeros((6, model.mj.nv))
        angles = body.joints[places].copy()
        for _ in range(_ROUNDS):
            there, orientation = body.site(hand.site)
            error = np.concatenate((position - there, rotation.rotation_vector(turn @ orientation.T)))
            if np.linalg.norm(error[:3]) < 1e-3 and np.linalg.norm(error[3:]) < 1e-2:
                break
            mujoco.mj_jacSite(model.mj, body.data, jacobian[:3], jacobian[3:], site)
            own = jacobian[:, dofs]
            change = own.T @ np.linalg.solve(own @ own.T + _DAMPING**2 * np.eye(6), error)
            change *= min(1.0, _STRIDE / max(float(np.abs(change).max()), 1e-9))
            angles = limits.position_within(angles + change)
            body.bend(dict(zip(names, angles.tolist(), strict=True)))
            body.update()
        there, orientation = body.site(hand.site)
        distance = float(np.linalg.norm(position - there))
        angle = float(np.linalg.norm(rotation.rotation_vector(turn @ orientation.T)))
        return dict(zip(names, angles.tolist(), strict=True)), distance, angle

    def _collisions(self, now: Body, goal: Mapping[str, float]) -> list[str]:
        """First pair of bodies that touch on the straight path."""
        begin = {name: float(now.joints[now.model.robot.index[name]]) for name in goal}
        for step in range(1, ON_THE_WAY + 1):
            share = step / ON_THE_WAY
            self._body.like(now)
            self._body.bend({name: begin[name] + share * (goal[name] - begin[name]) for name in goal})
            self._body.update()
            if pairs := self._touching() - self._resting:
                first, second = sorted(pairs)[0]
                where = "at the goal" if step == ON_THE_WAY else f"after {100.0 * share:.0f} % of the way"
                return [f"collision: {first} would touch {second} {where}"]
        return []

    def _touching(self) -> set[tuple[str, str]]:
        """Pairs of touching bodies."""
        model, data = self._body.model.mj, self._body.data
        mujoco.mj_collision(model, data)
        pairs = set()
        for contact in data.contact[: data.ncon]:
            one, other = (model.body(model.geom_bodyid[geom]).name for geom in contact.geom)
            pairs.add((min(one, other), max(one, other)))
        return pairs
