"""Key poses by optimisation: each in static equilibrium on its contacts, within every limit, none through the floor.

For the coordinates z of a pose (pelvis and joints, ``posture.py``) and the forces f on its contacts p(z), gravity's
potential V asks of the joints

    τ = ∂V/∂z − Σ (∂p/∂z)ᵀ·f,

which is zero for the pelvis, nobody holding it, and within its limits for a joint. Forces stay in the friction cone,
contacts at height 0, everything else above. Wanted are small torques, small forces, and poses near to the plan's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError, ValorError
from valor.planning.plan_table import ContactPoints, GetUpPlan, PlannedPose
from valor.planning.posture import BASE, Expression, SagittalPosture
from valor.robot.model import Model

TORQUE_COST, FORCE_COST, NEAR_COST = 0.02, 0.02, 1.0  # of shares of the limits, of the weight, of rad; squared
PENETRATION = 0.002  # of shapes that do not carry, into the floor [m]: what a soft contact lets in
PITCH_ROOM = 0.2  # of the range that the pelvis' pitch may have: the robot will not be quite where it was planned
ITERATIONS = 600
_QUIET: dict[str, Any] = {"print_time": 0, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": ITERATIONS}}


class NoSolutionFound(ValorError):  # noqa: N818 - it is an answer
    """The optimisation found no poses that fulfil the plan; names what is violated most."""


@dataclass(frozen=True, slots=True)
class KeyPose:
    """One pose as found.

    Attributes:
        plan: what it was to be.
        coordinates: (3 + m,) of a ``SagittalPosture``: x, z [m], pitch, joints [rad].
        forces: contact → (k, 3) on each of its points in the world [N]; on those of one side.
        torques: (m,) of one joint each [N·m].
    """

    plan: PlannedPose
    coordinates: FloatArray
    forces: Mapping[str, FloatArray]
    torques: FloatArray


class _Kinematics:
    """Functions of the coordinates that the problem is made of."""

    def __init__(self, posture: SagittalPosture, contacts: Mapping[str, ContactPoints]) -> None:
        z = ca.SX.sym("z", BASE + len(posture.joints))
        frames = posture.frames(z)
        com = posture.com(frames)
        self.places: dict[str, ca.Function] = {}
        self.forces: dict[str, ca.Function] = {}
        down = ca.DM([0.0, 0.0, -1.0])
        for name, contact in contacts.items():
            position, rotation = frames[_body(posture, name, contact.body)]
            f = ca.SX.sym("f", len(contact.points), 3)
            held = ca.SX.sym(
                "held", 3, len(contact.points)
            )  # what touches, in the body's frame: the ball's lowest point
            lowest = [np.array(point) + contact.radius * rotation.T @ down for point in contact.points]
            touching = [position + rotation @ held[:, i] for i in range(len(contact.points))]
            sides = 1.0 if posture.sides.body(contact.body) == contact.body else 2.0
            work = sides * sum(f[i, :] @ point for i, point in enumerate(touching))
            effect = ca.substitute(ca.gradient(work, z), held, ca.horzcat(*lowest))
            places = ca.substitute(ca.horzcat(*touching).T, held, ca.horzcat(*lowest))
            self.places[name] = ca.Function("at", [z], [places])
            self.forces[name] = ca.Function("of", [z, f], [effect])
        heights = []
        for shape in posture.shapes():
            position, rotation = frames[shape.body]
            heights += [(position + rotation @ point)[2] - shape.radius for point in shape.points]
        self.heights = ca.Function("heights", [z], [ca.vertcat(*heights)])
        self.com = ca.Function("com", [z], [com])
        self.gravity = ca.Function("gravity", [z], [ca.gradient(posture.weight * com[2], z)])


def posture_of(model: Model, plan: GetUpPlan) -> SagittalPosture:
    """The coordinates of a plan: joints that it moves, and those that its poses name besides.

    Raises:
        ConfigurationError: the plan names an unknown contact or joint.
    """
    for pose in plan.face_down:
        named = [*pose.loaded, *pose.touching, *([pose.com_of] if pose.com is not None else [])]
        if unknown := [name for name in named if name not in plan.contacts]:
            raise ConfigurationError(f"{pose.name}: unknown contact {unknown[0]!r}; expected one of {[*plan.contacts]}")
    return SagittalPosture(model, tuple(dict.fromkeys([*plan.moved, *(j for p in plan.face_down for j in p.near)])))


def find(posture: SagittalPosture, plan: GetUpPlan) -> list[KeyPose]:
    """Key poses for those of the plan that stand on contacts; the others are left out.

    Args:
        posture: the robot, by ``posture_of``.
        plan: what is wanted.

    Raises:
        ConfigurationError: a contact is of an unknown body.
        NoSolutionFound: there is no such pose, or the optimisation did not find it.
    """
    kinematics = _Kinematics(posture, plan.contacts)
    wanted = dict.fromkeys(posture.joints, 0.0)
    found = []
    for pose in plan.face_down:
        wanted |= pose.near
        if pose.loaded:
            goal = np.array([wanted[name] for name in posture.joints])
            found.append(_solve(posture, plan, kinematics, pose, goal))
    return found


def _solve(
    posture: SagittalPosture, plan: GetUpPlan, kinematics: _Kinematics, pose: PlannedPose, goal: FloatArray
) -> KeyPose:
    """The pose nearest to ``goal`` (m,) [rad] that stands."""
    problem = _Problem()
    moved = np.isin(posture.joints, plan.moved)
    lower, upper = posture.limits.lower + moved * plan.margin, posture.limits.upper - moved * plan.margin
    goal = np.clip(goal, lower, upper)
    z = problem.variable(BASE + len(posture.joints), _settled(kinematics, pose, goal))
    problem.require("the pelvis' place", z[0], 0.0, 0.0)
    problem.require("joint limits", z[BASE:], np.where(moved, lower, goal), np.where(moved, upper, goal))
    low, high = np.radians(pose.pitch)
    room = PITCH_ROOM * (high - low)
    problem.require("the pelvis' pitch", z[BASE - 1], low + room, high - room)

    forces: dict[str, Expression] = {}
    rest = kinematics.gravity(z)
    for name in pose.loaded:
        contact = plan.contacts[name]
        share = problem.variable((len(contact.points), 3), 0.25 / len(contact.points))  # of the weight
        problem.require(f"pressure on {name}", share[:, 2], 0.0, ca.inf)
        slip = share[:, 0] ** 2 + share[:, 1] ** 2 - (contact.friction * share[:, 2]) ** 2
        problem.require(f"friction of {name}", slip, -ca.inf, 0.0)
        problem.cost += FORCE_COST * ca.sumsqr(share)
        forces[name] = posture.weight * share
        rest -= kinematics.forces[name](z, forces[name])
    problem.require("balance", rest[:BASE] / posture.weight, 0.0, 0.0)
    torques = rest[BASE:] / posture.multiplicity
    problem.require("torque limits", torques / posture.limits.effort, -plan.torque, plan.torque)

    for name in (*pose.loaded, *pose.touching):
        problem.require(f"{name} on the floor", kinematics.places[name](z)[:, 2], 0.0, 0.0)
    problem.require("all above the floor", kinematics.heights(z), -PENETRATION, ca.inf)
    if pose.com is not None:
        ahead = kinematics.com(z)[0] - kinematics.places[pose.com_of](z)[0, 0]
        problem.require(f"the CoM ahead of {pose.com_of}", ahead, *pose.com)

    problem.cost += TORQUE_COST * ca.sumsqr(torques / posture.limits.effort) + NEAR_COST * ca.sumsqr(z[BASE:] - goal)
    try:
        value = problem.solve()
    except NoSolutionFound as error:
        raise NoSolutionFound(f"{pose.name}: {error}") from None
    return KeyPose(
        pose, value(z).ravel(), {name: value(f).reshape(-1, 3) for name, f in forces.items()}, value(torques)
    )


class _Problem:
    """An optimisation whose constraints have names, for who wants to know why there is no solution."""

    def __init__(self) -> None:
        self._opti = ca.Opti()
        self._names: list[str] = []
        self.cost: Expression = 0.0

    def variable(self, shape: int | tuple[int, int], initial: FloatArray | float) -> Expression:
        """A new one, and where the search begins."""
        variable = self._opti.variable(*(shape if isinstance(shape, tuple) else (shape,)))
        self._opti.set_initial(variable, initial)
        return variable

    def require(self, name: str, expression: Expression, lower: FloatArray | float, upper: FloatArray | float) -> None:
        """Each entry within its bounds."""
        rows = expression.numel()
        self._opti.subject_to(
            self._opti.bounded(np.broadcast_to(lower, rows), expression, np.broadcast_to(upper, rows))
        )
        self._names += [name] * rows

    def solve(self) -> Callable[[Expression], FloatArray]:
        """What gives an expression's value at the solution.

        Raises:
            NoSolutionFound: names what is violated most.
        """
        opti = self._opti
        opti.minimize(self.cost)
        opti.solver("ipopt", _QUIET)
        try:
            solution = opti.solve()
        except RuntimeError:
            g, low, high = (np.array(opti.debug.value(v)).ravel() for v in (opti.g, opti.lbg, opti.ubg))
            excess = np.maximum(low - g, g - high)
            worst = int(np.argmax(excess))
            status = opti.stats()["return_status"]
            raise NoSolutionFound(f"{status}, {self._names[worst]} off by {excess[worst]:.2g}") from None
        return lambda expression: np.array(solution.value(expression))


def _settled(kinematics: _Kinematics, pose: PlannedPose, goal: FloatArray) -> FloatArray:
    """The wished pose, its pelvis pitched as in the middle of what is allowed, let down on the floor."""
    z = np.concatenate([[0.0, 0.0, np.radians(np.mean(pose.pitch))], goal])
    z[1] = -float(np.min(np.array(kinematics.heights(z))))
    return z


def _body(posture: SagittalPosture, contact: str, body: str) -> int:
    try:
        return posture.model.body(body)
    except KeyError:
        raise ConfigurationError(f"contacts: {contact}: no body {body!r} in {posture.model.robot.model_file}") from None
