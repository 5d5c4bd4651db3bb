"""Forward and inverse kinematics of an arm, as compiled kernels.

Steps are damped least squares without the joints that would exceed a limit (Wampler 1986; Nakamura & Hanafusa 1986;
damping by the remaining error: Sugihara 2011).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, about, clipped, rotation_vector
from valor.robot.model import Model, matrix
from valor.robot.tables import Hand, Side

APPROACH, STREAM_APPROACH = 2.0, 8.0  # speed per distance from the goal, from a streamed one [1/s]
POSTURE = 0.3  # rate per distance from the preferred posture, in the null space [1/s]
DAMPING = 0.05  # λ: singular values below are damped
EXACT = 1e-6  # λ² of the null space projection
LESSER = 0.1  # weight of the orientation relative to the position, if a joint is stuck [m/rad]
TURN = 0.3  # weight of the orientation relative to the position, in a search [m/rad]
LEFT = 0.05  # λ² of a search per squared remaining error
LEAST = 1e-6  # least λ² of a search [m²]
STRIDE = 0.4  # largest motion of a joint in one step of a search [rad]


@dataclass(frozen=True)
class Speeds:
    """Largest speeds of an arm."""

    hand: float  # [m/s]
    turn: float  # of the hand's orientation [rad/s]
    joints: FloatArray  # (m,) [rad/s]


class ArmKinematics:
    """One arm of m joints, with w joints between it and the pelvis; kernels read and write these arrays.

    Attributes:
        joints: (m,) indices of the arm in every joint vector. others: (w,) indices of the w joints.
        position: (m,) [rad]. beside: (w,) positions of the others [rad].
        place: (3,) position of the target in pelvis [m]. turn: (3, 3) its rotation.
        carried: (6,) its twist by the pelvis. streamed: (6,) that of a stream of goals; 0 for single goals.
        posture: (m,) preferred posture of the null space [rad]. stuck: (m,) 1 for joints that do not move.
        rate: (m,) output of ``lead`` and ``move`` [rad/s]. stepped: (m,) output of ``search`` [rad].
        errors: (2,) of the hand at ``position``, output of ``look``, ``lead``, ``search`` [m, rad].
    """

    def __init__(
        self, model: Model, hand: Hand, side: Side, bounds: tuple[FloatArray, FloatArray], speeds: Speeds
    ) -> None:
        """Build the kernels; ``bounds`` are (m,) lower and upper joint positions [rad]."""
        robot, mj = model.robot, model.mj
        self.joints = robot.group_indices(f"{side}_arm")
        arm = [robot.joints[i] for i in self.joints]
        self._model, self._site, self._arm = model, model.site(hand.site), arm
        self._chain = _chain(mj, int(mj.site_bodyid[self._site]), model.body(robot.tables.base))
        hinges = [mj.joint(j).name for body in self._chain for j in _joints(mj, body)]
        self._others = [name for name in hinges if name not in arm]
        self.others = np.array([robot.index[name] for name in self._others], dtype=np.intp)
        self._lower, self._upper = bounds
        self._speeds = speeds
        m = len(arm)
        self.position, self.posture, self.stuck = np.zeros(m), np.zeros(m), np.zeros(m)
        self.beside = np.zeros(max(1, len(self._others)))
        self.place, self.turn, self.carried = np.zeros(3), np.eye(3), np.zeros(6)
        self.streamed = np.zeros(6)
        self.rate, self.stepped, self.errors = np.zeros(m), np.zeros(m), np.zeros(2)
        pose = (self.position, self.beside, self.place, self.turn)
        self.look = Kernel("hand", self._look, pose, (self.errors,))
        self.lead = Kernel(
            "lead",
            self._lead,
            (*pose, self.carried, self.streamed, self.posture, self.stuck),
            (self.rate, self.errors),
        )
        self.search = Kernel("search", self._search, (*pose, self.stuck), (self.stepped, self.errors))
        self.move = Kernel("move", self._move, (self.position, self.beside, self.posture), (self.rate,))

    def stand(self, joint_position: FloatArray) -> None:
        """Set ``beside`` from (n,) positions of the robot's joints [rad]."""
        if self.others.size:
            self.beside[:] = joint_position[self.others]

    def carries(self, body: int) -> bool:
        """Return whether a body moves with the arm."""
        return not set(self._arm).isdisjoint(self._model.joints_above(body))

    def _hand(self, angles: Expression, beside: Expression) -> tuple[Expression, Expression, Expression]:
        """Position (3,) and rotation (3, 3) of the hand in pelvis, Jacobian (6, m)."""
        mj = self._model.mj
        values = dict(zip(self._arm, ca.vertsplit(angles), strict=True))
        values |= dict(zip(self._others, ca.vertsplit(beside), strict=False))
        place, turn = ca.SX.zeros(3), ca.SX.eye(3)
        axes: dict[str, tuple[Expression, Expression]] = {}
        for body in self._chain:
            place = place + turn @ mj.body_pos[body]
            turn = turn @ _sparse(mj.body_quat[body])
            for joint in _joints(mj, body):
                name = mj.joint(joint).name
                anchor = place + turn @ mj.jnt_pos[joint]
                axes[name] = (turn @ mj.jnt_axis[joint], anchor)
                turn = turn @ about(mj.jnt_axis[joint], values[name])
                place = anchor - turn @ mj.jnt_pos[joint]
        place = place + turn @ mj.site_pos[self._site]
        turn = turn @ _sparse(mj.site_quat[self._site])
        columns = [
            ca.vertcat(ca.cross(axis, place - anchor), axis) for axis, anchor in (axes[name] for name in self._arm)
        ]
        return place, turn, ca.horzcat(*columns)

    def _off(
        self, angles: Expression, beside: Expression, place: Expression, turn: Expression
    ) -> tuple[Expression, Expression, Expression]:
        """Twist (6,) from the hand to the target; its norms (2,); Jacobian (6, m)."""
        at, attitude, jacobian = self._hand(angles, beside)
        twist = ca.vertcat(place - at, rotation_vector(turn @ attitude.T))
        return twist, ca.vertcat(ca.norm_2(twist[:3]), ca.norm_2(twist[3:])), jacobian

    def _look(self, *pose: Expression) -> tuple[Expression]:
        return (self._off(*pose)[1],)

    def _lead(self, *inputs: Expression) -> tuple[Expression, Expression]:
        """Rates towards a target."""
        angles, beside, place, turn, carried, streamed, posture, stuck = inputs
        twist, errors, jacobian = self._off(angles, beside, place, turn)
        # Position and orientation arrive together: one factor for the twist.
        fastest = self._speeds.hand / ca.fmax(errors[0], 1e-9), self._speeds.turn / ca.fmax(errors[1], 1e-9)
        streams = ca.sumsqr(streamed) > 0.0
        approach = ca.if_else(streams, STREAM_APPROACH, APPROACH)
        twist = ca.fmin(approach, ca.fmin(*fastest)) * twist + streamed + carried
        excess = ca.fmax(ca.norm_2(twist[:3]) / self._speeds.hand, ca.norm_2(twist[3:]) / self._speeds.turn)
        twist /= ca.if_else(streams, ca.fmax(1.0, excess), 1.0)
        lesser = ca.if_else(ca.mmax(stuck) > 0.0, LESSER, 1.0)
        twist, jacobian = _weighted(lesser, twist), _weighted(lesser, jacobian)
        idle = POSTURE * (posture - angles)
        free = 1.0 - stuck
        rate = _least_squares(jacobian, twist, idle, free)
        free *= 1.0 - self._passing(angles, rate)
        rate = _least_squares(jacobian, twist, idle, free)
        rate /= ca.fmax(1.0, ca.mmax(ca.fabs(rate) / ca.DM(self._speeds.joints)))
        return rate, errors

    def _search(
        self, angles: Expression, beside: Expression, place: Expression, turn: Expression, stuck: Expression
    ) -> tuple[Expression, Expression]:
        twist, errors, jacobian = self._off(angles, beside, place, turn)
        twist, jacobian = _weighted(TURN, twist), _weighted(TURN, jacobian)
        free = (1.0 - stuck) * (1.0 - self._passing(angles, jacobian.T @ twist))
        damping = LEFT * ca.sumsqr(twist) + LEAST
        step = _damped(jacobian, free, twist, damping)
        free *= 1.0 - self._passing(angles, step)
        step = _damped(jacobian, free, twist, damping)
        step /= ca.fmax(1.0, ca.mmax(ca.fabs(step)) / STRIDE)
        return clipped(angles + step, ca.DM(self._lower), ca.DM(self._upper)), errors

    def _move(self, angles: Expression, beside: Expression, posture: Expression) -> tuple[Expression]:
        jacobian = self._hand(angles, beside)[2]
        rate = APPROACH * (posture - angles)
        twist = jacobian @ rate
        return (
            rate
            / ca.fmax(
                ca.fmax(1.0, ca.mmax(ca.fabs(rate) / ca.DM(self._speeds.joints))),
                ca.fmax(ca.norm_2(twist[:3]) / self._speeds.hand, ca.norm_2(twist[3:]) / self._speeds.turn),
            ),
        )

    def _passing(self, angles: Expression, rate: Expression) -> Expression:
        """1 for each joint that is at a limit and would exceed it."""
        return (angles <= self._lower) * (rate < 0.0) + (angles >= self._upper) * (rate > 0.0)


def _chain(mj: mujoco.MjModel, body: int, base: int) -> list[int]:
    chain = list[int]()
    while body not in (0, base):
        chain.append(body)
        body = int(mj.body_parentid[body])
    return chain[::-1]


def _joints(mj: mujoco.MjModel, body: int) -> range:
    first = int(mj.body_jntadr[body])
    return range(first, first + int(mj.body_jntnum[body]))


def _sparse(quaternion: FloatArray) -> Expression:
    return ca.SX(ca.sparsify(ca.DM(matrix(quaternion))))


def _weighted(turn: Expression, rows: Expression) -> Expression:
    return ca.vertcat(rows[:3, :], turn * rows[3:, :])


def _damped(jacobian: Expression, free: Expression, twist: Expression, damping: Expression) -> Expression:
    """(m,) Jᵀ·(J·Jᵀ + damping·1)⁻¹·twist of the free joints."""
    moving = jacobian @ ca.diag(free)
    return moving.T @ _solved(moving @ moving.T + damping * ca.SX.eye(6), twist)


def _least_squares(jacobian: Expression, twist: Expression, idle: Expression, free: Expression) -> Expression:
    """(m,) damped least squares for a twist (6,); ``idle`` rates are followed in the null space."""
    moving, idle = jacobian @ ca.diag(free), free * idle
    square = moving @ moving.T
    kept = _solved(square + EXACT * ca.SX.eye(6), moving @ idle)
    wished = _solved(square + (EXACT + DAMPING**2) * ca.SX.eye(6), twist)
    return idle + moving.T @ (wished - kept)


def _solved(square: Expression, right: Expression) -> Expression:
    diagonal, upper, order = ca.ldl(ca.densify(square), False)
    return ca.ldl_solve(right, diagonal, upper, order)
