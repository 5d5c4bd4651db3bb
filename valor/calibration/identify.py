"""Calibration table of an arm, from a recorded motion.

For a set-point p with gains k, d and an effort τ_ff, the torque of a joint's drive is

    τ = share·τ_ff + strength·(k·dead(p − q, b) + d·(ṗ − q̇)),

where ``dead`` is zero within ± b, half the play, and smaller by b outside. For a given b this is linear in the other
unknowns; b minimises the error.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from valor.calibration import dynamics
from valor.calibration.record import Record
from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.robot.arm_calibration import ArmCalibration, JointCalibration, LinkCalibration
from valor.robot.description import RobotDescription
from valor.robot.model import Model

WIDEST = 0.15  # largest half width [rad]
STEPS = 61  # of the search
LEAST_PLAY = 0.0008  # smallest half width that is identified [rad]
BETTER = 0.95  # largest error with play, as a share of the error without, that shows the play
UNINFORMATIVE = 0.95  # error, as a share of the torque, from which nominal parameters are kept
LOADED = 0.5  # torque that presses a gear to one side of its play [N·m]
SEEN = 20  # least number of moments with that torque


@dataclass(frozen=True)
class Servo:
    """A joint's drive."""

    share: float  # of τ_ff, 0 to 1
    strength: float  # factor of the gains
    half_play: float | None  # b [rad]; None: unknown


def identify_servo(
    *,
    error: FloatArray,
    rate_error: FloatArray,
    feed_forward: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    effort: FloatArray,
) -> Servo:
    """Identify the drive of one joint; all arguments (T,).

    ``error``: p − q [rad]; ``rate_error``: ṗ − q̇ [rad/s]; ``feed_forward``: τ_ff [N·m]; ``stiffness``: k [N·m/rad];
    ``damping``: d [N·m·s/rad]; ``effort``: τ, measured [N·m].
    """

    def fit(half: float) -> tuple[tuple[float, float], float]:
        dead = error - np.clip(error, -half, half)
        servo = stiffness * dead + damping * rate_error
        found = _not_negative(feed_forward, servo, effort)
        return found, float(np.linalg.norm(effort - found[0] * feed_forward - found[1] * servo))

    widest = min(WIDEST, float(np.abs(error).max(initial=0.0)))
    looks = np.linspace(0.0, widest, STEPS)
    best = int(np.argmin([fit(half)[1] for half in looks]))
    around = (looks[max(best - 1, 0)], looks[min(best + 1, STEPS - 1)])
    half = float(minimize_scalar(lambda b: fit(b)[1], bounds=around, method="bounded", options={"xatol": 1e-5}).x)
    shows = half >= LEAST_PLAY and fit(half)[1] < BETTER * fit(0.0)[1]
    half = half if shows else 0.0
    (taken, strength), left = fit(half)
    turned = int((np.abs(strength * stiffness * (error - np.clip(error, -half, half))) > LOADED).sum())
    if left > UNINFORMATIVE * float(np.linalg.norm(effort)):  # torques no larger than the sensors' errors
        return Servo(1.0, 1.0, None)
    share = min(taken / strength, 1.0) if strength > 0.0 else 1.0
    return Servo(float(share), float(strength), half if shows and turned >= SEEN else None)


def _not_negative(one: FloatArray, other: FloatArray, wanted: FloatArray) -> tuple[float, float]:
    """Non-negative least squares of two columns (T,)."""
    a, b, c = float(one @ one), float(one @ other), float(other @ other)
    x, y = float(one @ wanted), float(other @ wanted)
    if (scale := a * c - b * b) > 1e-9 * a * c:
        first, second = (c * x - b * y) / scale, (a * y - b * x) / scale
        if first >= 0.0 and second >= 0.0:
            return first, second
    alone = (max(x / a, 0.0) if a else 0.0, 0.0), (0.0, max(y / c, 0.0) if c else 0.0)
    return max(alone, key=lambda shares: shares[0] * x + shares[1] * y)  # the column that explains more


FEWEST = 200  # moments in which a joint moves
DIGITS = 5
WEAKEST, STRONGEST = 0.01, 2.0  # servo


class UnidentifiedError(ValorError):
    """The motions do not determine the parameters."""


@dataclass(frozen=True)
class Found:
    """Result for an arm: the table for the robot's folder, and by joint the RMS error of the nominal model [N·m]."""

    table: ArmCalibration
    nominal_residual: dict[str, float]


def identify(model: Model, group: str, record: Record, poses: int) -> Found:
    """Identify an arm's drives and links from a record of its motions through a number of poses.

    ``model``: nominal, with every joint. Raises ``UnidentifiedError`` with a joint that moved too little.
    """
    robot = model.robot
    joints = tuple(robot.tables.group(group))
    for name in joints:
        moved = int((np.abs(record.velocity[:, robot.index[name]]) > dynamics.MOVING).sum())
        if moved < FEWEST:
            what = f"{name} moved in {moved} moments of {len(record.time)}; expected {FEWEST} or more"
            raise UnidentifiedError(f"{group}: too little motion: {what}")
    friction, bodies = dynamics.identify(model, joints, record)
    table = ArmCalibration(
        poses=poses,
        samples=len(record.time),
        joints={name: _joint(friction[name], _servo(robot, name, record)) for name in joints},
        links={
            name: LinkCalibration(mass=round(body.mass, DIGITS), com=[round(float(x), DIGITS) for x in body.com])
            for name, body in bodies.items()
        },
    )
    return Found(table, {name: each.nominal_residual for name, each in friction.items()})


def _servo(robot: RobotDescription, name: str, record: Record) -> Servo:
    i = robot.index[name]
    return identify_servo(
        error=record.wanted_position[:, i] - record.position[:, i],
        rate_error=record.wanted_velocity[:, i] - record.velocity[:, i],
        feed_forward=record.wanted_effort[:, i],
        stiffness=record.stiffness[:, i],
        damping=record.damping[:, i],
        effort=record.effort[:, i],
    )


def _joint(friction: dynamics.Friction, drive: Servo) -> JointCalibration:
    return JointCalibration(
        friction=round(friction.coulomb, DIGITS),
        damping=round(friction.viscous, DIGITS),
        offset=round(friction.offset, DIGITS),
        backlash=None if drive.half_play is None else round(2.0 * drive.half_play, DIGITS),
        effort_share=round(drive.share, DIGITS),
        strength=round(min(max(drive.strength, WEAKEST), STRONGEST), DIGITS),
        residual=round(friction.residual, DIGITS),
    )
