"""How a robot stands: knees bent, soles level under the centre of mass, arms where they touch nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
from scipy.optimize import least_squares

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.robot.checks import SIDES
from valor.robot.legs import knee

HIP_SHARE = 0.884  # height of the hip over the ankle, of the straight leg's length: ESCHER's, and THOR's
_UPRIGHT = 1e-3  # weight of angles that do not matter towards zero


@dataclass(frozen=True)
class Chain:
    """A leg or an arm in the generated model: joints from the trunk out, and the site at its end."""

    joints: tuple[str, ...]
    site: str
    middle: float = 0.0  # x of a sole's middle in its site's frame [m]


@dataclass
class Stance:
    """The nominal posture and what follows from it.

    Attributes:
        angles: joint → angle [rad]; of joints that are not zero.
        base_height: of the base over the soles [m].
        leg_length: from hip to ankle, straight [m].
        hip_height: likewise, in this posture [m].
        com_height: over the soles [m].
        width: between the soles' origins [m].
        knees: of the left and the right leg.
    """

    angles: dict[str, float]
    base_height: float
    leg_length: float
    hip_height: float
    com_height: float
    width: float
    knees: tuple[str, str]


class Poser:
    """Solves for joint angles of a generated model within its limits."""

    def __init__(self, mj: mujoco.MjModel, limits: Mapping[str, tuple[float, float]]) -> None:
        self.mj, self.data = mj, mujoco.MjData(mj)
        self.limits = dict(limits)

    def put(self, angles: Mapping[str, float]) -> None:
        """Compute the kinematics of a posture, the base at the origin."""
        self.data.qpos[:] = 0.0
        self.data.qpos[3] = 1.0
        for name, angle in angles.items():
            self.data.qpos[self.mj.joint(name).qposadr[0]] = angle
        mujoco.mj_fwdPosition(self.mj, self.data)

    def rest(self, angles: Mapping[str, float], springs: Mapping[str, float]) -> dict[str, float]:
        """Where joints that nothing drives are when the others are at some angles: as what couples them wants it.

        Args:
            angles: of the others [rad].
            springs: of each of these joints, where its spring, or else its zero, is [rad].
        """
        names = list(springs)
        if not names:
            return {}
        wanted = np.array([springs[name] for name in names])
        low, high = np.transpose([self._range(name) for name in names])

        def residual(x: FloatArray) -> FloatArray:
            self.put(dict(angles) | dict(zip(names, x, strict=True)))
            return np.concatenate([self.data.efc_pos[: self.data.ne], _UPRIGHT * (x - wanted)])

        solution = least_squares(residual, np.clip(wanted, low + 1e-6, high - 1e-6), bounds=(low, high), max_nfev=100)
        return {name: round(float(angle), 4) for name, angle in zip(names, solution.x, strict=True)}

    def _range(self, name: str) -> tuple[float, float]:
        joint = self.mj.joint(name)
        low, high = (float(x) for x in joint.range)
        return (low, high) if self.mj.jnt_limited[joint.id] else (-np.pi, np.pi)

    def site(self, name: str) -> tuple[FloatArray, FloatArray]:
        """(3,) position and (3, 3) orientation."""
        site = self.data.site(name)
        return site.xpos.copy(), site.xmat.reshape(3, 3).copy()

    def anchor(self, joint: str) -> FloatArray:
        """(3,) of a joint [m]."""
        anchor: FloatArray = self.data.joint(joint).xanchor.copy()
        return anchor

    def touching(self) -> list[tuple[str, str]]:
        """Pairs of bodies whose shapes overlap in the posture that was put last."""
        pairs = {
            tuple(sorted(self.mj.body(self.mj.geom_bodyid[geom]).name for geom in contact.geom))
            for contact in self.data.contact
            if contact.dist < 0
        }
        return sorted((a, b) for a, b in pairs)

    def stand(self, legs: Mapping[str, Chain], half_width: float, arms: dict[str, float]) -> Stance:
        """The nominal posture, with arms at given angles.

        Raises:
            ConfigurationError: the legs cannot put both soles level under the centre of mass.
        """
        self.put(arms)
        knees = {
            side: knee(self.mj, self.data, {name: self.limits[name] for name in legs[side].joints}) for side in SIDES
        }
        self.put(arms)
        pitch = {side: self._pitch_joints(legs[side]) for side in SIDES}
        length = float(np.mean([self._length(pitch[side]) for side in SIDES]))
        apart = float(np.mean([abs(self.site(legs[side].site)[0][1]) for side in SIDES]))
        apart = max(apart, 1.17 * half_width)
        names = [name for side in SIDES for name in legs[side].joints]
        low, high = (np.array([self.limits[name][i] for name in names]) for i in (0, 1))
        start = self._bent(names, knees, pitch)
        self.put(arms | dict(zip(names, start, strict=True)))
        height = -float(np.mean([self.site(legs[side].site)[0][2] for side in SIDES]))

        def residual(x: FloatArray) -> FloatArray:
            self.put(arms | dict(zip(names, x[:-2], strict=True)))
            mujoco.mj_comPos(self.mj, self.data)
            com = self.data.subtree_com[1]
            parts: list[FloatArray | list[float]] = [_UPRIGHT * (x[:-2] - start), [1e-1 * (x[-2] - height)]]
            for side, y in (("left", apart), ("right", -apart)):
                place, rotation = self.site(legs[side].site)
                middle = place[0] + legs[side].middle
                parts += [
                    (place[1:] - [y, -x[-2]]),
                    [place[0] - x[-1], (com[0] - middle)],
                    [rotation[2, 0], rotation[2, 1], rotation[1, 0]],
                    [(self._hip_height(pitch[side]) - HIP_SHARE * length)],
                ]
            return np.concatenate(parts)

        solution = least_squares(
            residual,
            [*start, height, 0.0],
            bounds=([*low, 0.0, -np.inf], [*high, np.inf, np.inf]),
            x_scale=np.array([1.0] * len(names) + [0.1, 0.1]),
            max_nfev=200,
        )
        angles = dict(zip(names, solution.x[:-2].tolist(), strict=True))
        self.put(arms | angles)
        if self._off_the_ground(legs, solution.x[-2]) > 0.01:
            raise ConfigurationError("the legs' limits do not let both soles stand level with the knees bent")
        mujoco.mj_comPos(self.mj, self.data)
        return Stance(
            {name: round(angle, 4) for name, angle in (arms | angles).items() if abs(angle) > 5e-5},
            float(solution.x[-2]),
            length,
            float(np.mean([self._hip_height(pitch[side]) for side in SIDES])),
            float(self.data.subtree_com[1][2] + solution.x[-2]),
            2 * apart,
            (knees["left"][0], knees["right"][0]),
        )

    def _off_the_ground(self, legs: Mapping[str, Chain], height: float) -> float:
        """The larger of how far a sole is from the ground [m], and one less the cosine of its tilt."""
        soles = [self.site(legs[side].site) for side in SIDES]
        return max(max(float(abs(place[2] + height)), float(1 - rotation[2, 2])) for place, rotation in soles)

    def _bent(
        self, names: Sequence[str], knees: Mapping[str, tuple[str, float]], pitch: Mapping[str, Sequence[str]]
    ) -> FloatArray:
        """(k,) angles to begin the search with: knees bent, hips and ankles half as much the other way [rad]."""
        low, high = (np.array([self.limits[name][i] for name in names]) for i in (0, 1))
        bend = 2 * np.arccos(HIP_SHARE)
        start = np.clip(np.zeros(len(names)), low + 1e-3, high - 1e-3)
        for side in SIDES:
            name, sign = knees[side]
            start[names.index(name)] = np.clip(sign * bend, low[names.index(name)], high[names.index(name)])
            for joint, share in ((pitch[side][0], -0.5), (pitch[side][-1], -0.5)):
                turn = float(np.sign(self.data.joint(joint).xaxis[1]) * np.sign(self.data.joint(name).xaxis[1]))
                i = names.index(joint)
                start[i] = np.clip(share * sign * turn * bend, low[i], high[i])
        return start

    def _length(self, pitch: Sequence[str]) -> float:
        """From the first to the last of a leg's pitch joints, along it [m]."""
        return float(sum(np.linalg.norm(b - a) for a, b in pairwise([self.anchor(joint) for joint in pitch])))

    def _hip_height(self, pitch: Sequence[str]) -> float:
        return float(self.anchor(pitch[0])[2] - self.anchor(pitch[-1])[2])

    def _pitch_joints(self, leg: Chain) -> list[str]:
        return [name for name in leg.joints if abs(self.data.joint(name).xaxis[1]) > 0.9]

    def reach(self, arm: Chain, direction: FloatArray, rest: Mapping[str, float]) -> dict[str, float]:
        """Angles that put a hand in a direction from its shoulder, (3,) in lengths of the arm."""
        names = list(arm.joints)
        low, high = (np.array([self.limits[name][i] for name in names]) for i in (0, 1))
        self.put(rest)
        points = [self.anchor(name) for name in names] + [self.site(arm.site)[0]]
        length = float(sum(np.linalg.norm(b - a) for a, b in pairwise(points)))
        goal = points[0] + length * direction

        def residual(x: FloatArray) -> FloatArray:
            self.put(dict(rest) | dict(zip(names, x, strict=True)))
            return np.concatenate([(self.site(arm.site)[0] - goal) / length, 0.03 * x])

        best = None
        for start in (0.0, 0.4, -0.4):
            solution = least_squares(
                residual, np.clip(np.full(len(names), start), low + 1e-3, high - 1e-3), bounds=(low, high), max_nfev=60
            )
            if best is None or solution.cost < best.cost - 1e-4:
                best = solution
        assert best is not None
        return {name: round(float(angle), 3) for name, angle in zip(names, best.x, strict=True)}
