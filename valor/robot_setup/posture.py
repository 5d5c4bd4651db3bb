"""Solution of the nominal posture (knees bent, soles level under the centre of mass) and of arm presets."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
from scipy.optimize import least_squares

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.robot.legs import knee, pitch_joints
from valor.robot.tables import SIDES

HIP_RATIO = 0.884  # height of the hip over the ankle, relative to the straight leg's length: ESCHER's and THOR's
SIDE_LEAN = 0.36  # of a leg at the end of a side step; the nominal posture leans by what ankle roll lacks of it [rad]
_ROUNDING = 1.5e-3  # of angles to 3 decimals, and of limits to 4 digits [rad]
_REGULARIZATION = 1e-3  # weight that draws undetermined angles to their start


@dataclass(frozen=True)
class Chain:
    """Leg or arm of the generated model: joints outward from the trunk, and the site at its end."""

    joints: tuple[str, ...]
    site: str
    middle: float = 0.0  # x of the sole's middle in the site's frame [m]


@dataclass
class Stance:
    """Nominal posture and its dimensions."""

    angles: dict[str, float]  # of joints not at zero [rad]
    base_height: float  # over the soles [m]
    leg_length: float  # from hip to ankle of the straight leg [m]
    hip_height: float  # over the ankle [m]
    com_height: float  # over the soles [m]
    width: float  # between the soles' origins [m]
    step_width: float  # likewise, under legs that do not lean [m]
    knees: tuple[str, str]  # left and right


class Poser:
    """Solves for joint angles of a generated model within its limits."""

    def __init__(self, mj: mujoco.MjModel) -> None:
        self.mj, self.data = mj, mujoco.MjData(mj)

    def set_posture(self, angles: Mapping[str, float]) -> None:
        """Compute the kinematics of a posture, with the base at the origin and other joints at zero."""
        self.data.qpos[:] = 0.0
        self.data.qpos[3] = 1.0
        for name, angle in angles.items():
            self.data.qpos[self.mj.joint(name).qposadr[0]] = angle
        mujoco.mj_fwdPosition(self.mj, self.data)

    def limits(self, name: str) -> tuple[float, float]:
        """Return the limits of a joint; half a turn both ways if it has none [rad]."""
        joint = self.mj.joint(name)
        low, high = (float(x) for x in joint.range)
        return (low, high) if self.mj.jnt_limited[joint.id] else (-np.pi, np.pi)

    def bounds(self, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper limits of joints, (k,) each [rad], inside of which a rounded angle stays."""
        low, high = np.transpose([self.limits(name) for name in names])
        margin = np.minimum(_ROUNDING, (high - low) / 4)
        return low + margin, high - margin

    def solve_passive(self, angles: Mapping[str, float], springs: Mapping[str, float]) -> dict[str, float]:
        """Return the angles of passive joints that satisfy their constraints, near those of relaxed springs [rad]."""
        names = list(springs)
        if not names:
            return {}
        relaxed = np.array([springs[name] for name in names])
        low, high = self.bounds(names)

        def residual(x: FloatArray) -> FloatArray:
            self.set_posture(dict(angles) | dict(zip(names, x, strict=True)))
            return np.concatenate([self.data.efc_pos[: self.data.ne], _REGULARIZATION * (x - relaxed)])

        solution = least_squares(residual, np.clip(relaxed, low + 1e-6, high - 1e-6), bounds=(low, high), max_nfev=100)
        return {name: round(float(angle), 4) for name, angle in zip(names, solution.x, strict=True)}

    def site(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) [m] and orientation (3, 3) of a site."""
        site = self.data.site(name)
        return site.xpos.copy(), site.xmat.reshape(3, 3).copy()

    def anchor(self, joint: str) -> FloatArray:
        """Return the position of a joint's axis, (3,) [m]."""
        anchor: FloatArray = self.data.joint(joint).xanchor.copy()
        return anchor

    def overlaps(self) -> list[tuple[str, str]]:
        """Return the pairs of bodies whose shapes overlap in the current posture."""
        pairs = {
            tuple(sorted(self.mj.body(self.mj.geom_bodyid[geom]).name for geom in contact.geom))
            for contact in self.data.contact
            if contact.dist < 0
        }
        return sorted((a, b) for a, b in pairs)

    def solve_stance(self, legs: Mapping[str, Chain], half_width: float, arms: dict[str, float]) -> Stance:
        """Solve the nominal posture for soles of a half width [m] and angles of the arms [rad].

        Raises ConfigurationError: the legs cannot put both soles level under the centre of mass.
        """
        self.set_posture(arms)
        knees = {
            side: knee(self.mj, self.data, {name: self.limits(name) for name in legs[side].joints}) for side in SIDES
        }
        self.set_posture(arms)
        lateral = np.array([0.0, 1.0, 0.0])
        pitch = {side: pitch_joints(self.data, legs[side].joints, lateral) for side in SIDES}
        length = float(np.mean([_length(map(self.anchor, pitch[side])) for side in SIDES]))
        apart = float(np.mean([abs(self.site(legs[side].site)[0][1]) for side in SIDES]))
        lean = max(0.0, SIDE_LEAN - min(self._side_lean(side, legs[side], pitch[side]) for side in SIDES))
        least = 1.17 * half_width
        step_width = 2 * max(apart, least)
        apart = max(apart + length * np.sin(lean), least)
        names = [name for side in SIDES for name in legs[side].joints]
        low, high = self.bounds(names)
        start = self._bent(names, knees, pitch)
        self.set_posture(arms | dict(zip(names, start, strict=True)))
        height = -float(np.mean([self.site(legs[side].site)[0][2] for side in SIDES]))

        def residual(x: FloatArray) -> FloatArray:
            self.set_posture(arms | dict(zip(names, x[:-2], strict=True)))
            mujoco.mj_comPos(self.mj, self.data)
            com = self.data.subtree_com[1]
            residuals: list[FloatArray | list[float]] = [_REGULARIZATION * (x[:-2] - start), [1e-1 * (x[-2] - height)]]
            for side, y in (("left", apart), ("right", -apart)):
                position, rotation = self.site(legs[side].site)
                middle = position[0] + legs[side].middle
                residuals += [
                    (position[1:] - [y, -x[-2]]),
                    [position[0] - x[-1], (com[0] - middle)],
                    [rotation[2, 0], rotation[2, 1], rotation[1, 0]],
                    [(self._hip_height(pitch[side]) - HIP_RATIO * length)],
                ]
            return np.concatenate(residuals)

        solution = least_squares(
            residual,
            [*start, height, 0.0],
            bounds=([*low, 0.0, -np.inf], [*high, np.inf, np.inf]),
            x_scale=np.array([1.0] * len(names) + [0.1, 0.1]),
            max_nfev=200,
        )
        angles = dict(zip(names, solution.x[:-2].tolist(), strict=True))
        self.set_posture(arms | angles)
        soles = [self.site(legs[side].site) for side in SIDES]
        if max(max(abs(position[2] + solution.x[-2]), 1 - rotation[2, 2]) for position, rotation in soles) > 0.01:
            raise ConfigurationError("the legs' limits do not let both soles stand level with the knees bent")
        mujoco.mj_comPos(self.mj, self.data)
        return Stance(
            {name: round(angle, 4) for name, angle in (arms | angles).items() if abs(angle) > 5e-5},
            float(solution.x[-2]),
            length,
            float(np.mean([self._hip_height(pitch[side]) for side in SIDES])),
            float(self.data.subtree_com[1][2] + solution.x[-2]),
            2 * apart,
            step_width,
            (knees["left"][0], knees["right"][0]),
        )

    def _side_lean(self, side: str, leg: Chain, pitch: Sequence[str]) -> float:
        """Return how far the ankle lets a leg lean outward over a level sole [rad]."""
        roll = next(name for name in leg.joints[-2:] if name != pitch[-1])
        low, high = self.limits(roll)
        return high if (self.data.joint(roll).xaxis[0] > 0) == (side == "right") else -low

    def _bent(
        self, names: Sequence[str], knees: Mapping[str, tuple[str, float]], pitch: Mapping[str, Sequence[str]]
    ) -> FloatArray:
        """Return initial angles, (k,) [rad]: knees bent, hips and ankles half as much the other way."""
        low, high = self.bounds(names)
        bend = 2 * np.arccos(HIP_RATIO)
        start = np.clip(np.zeros(len(names)), low + 1e-3, high - 1e-3)
        for side in SIDES:
            name, sign = knees[side]
            start[names.index(name)] = np.clip(sign * bend, low[names.index(name)], high[names.index(name)])
            for joint in (pitch[side][0], pitch[side][-1]):
                direction = float(np.sign(self.data.joint(joint).xaxis[1]) * np.sign(self.data.joint(name).xaxis[1]))
                i = names.index(joint)
                start[i] = np.clip(-0.5 * sign * direction * bend, low[i], high[i])
        return start

    def _hip_height(self, pitch: Sequence[str]) -> float:
        return float(self.anchor(pitch[0])[2] - self.anchor(pitch[-1])[2])

    def solve_reach(
        self, arm: Chain, direction: FloatArray, rest: Mapping[str, float], near: Mapping[str, float] | None = None
    ) -> dict[str, float]:
        """Return the angles [rad], near others or 0, that put a hand in a direction (3,) from its shoulder.

        The direction is in lengths of the arm.
        """
        names = list(arm.joints)
        low, high = self.bounds(names)
        self.set_posture(rest)
        points = [self.anchor(name) for name in names] + [self.site(arm.site)[0]]
        length = _length(points)
        goal = points[0] + length * direction
        centre = np.array([near[name] if near else 0.0 for name in names])

        def residual(x: FloatArray) -> FloatArray:
            self.set_posture(dict(rest) | dict(zip(names, x, strict=True)))
            return np.concatenate([(self.site(arm.site)[0] - goal) / length, 0.03 * (x - centre)])

        best = None
        for start in (0.0, 0.4, -0.4):
            solution = least_squares(
                residual, np.clip(centre + start, low + 1e-3, high - 1e-3), bounds=(low, high), max_nfev=60
            )
            if best is None or solution.cost < best.cost - 1e-4:
                best = solution
        assert best is not None
        return {name: round(float(angle), 3) for name, angle in zip(names, best.x, strict=True)}


def _length(points: Iterable[FloatArray]) -> float:
    """Return the length of a path through points (3,) [m]."""
    return float(sum(np.linalg.norm(b - a) for a, b in pairwise(points)))
