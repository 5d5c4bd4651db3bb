"""Key poses by optimisation: each in static equilibrium on its contacts, within all limits, above the floor.

With coordinates z of a pose (pelvis and joints, ``posture.py``), forces f on its contacts p(z) and the potential V of
gravity, the generalised torques are

    τ = ∂V/∂z − Σ (∂p/∂z)ᵀ·f,

zero for the pelvis and within the limits for joints. Forces stay in the friction cone, contacts at height 0, other
shapes above. The cost is the sum of squared torques, forces and distances from the planned pose. MuJoCo verifies the
solution independently (``check``).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import mujoco
import numpy as np
from msgspec import Meta

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError, ValorError
from valor.common.table import NonNegative, Positive, Table
from valor.get_up_planning.posture import BASE, Expression, SagittalPosture, ends
from valor.robot.get_up_table import Balance
from valor.robot.model import Model

PLAN_FILE = "get_up_plan.yaml"  # in the robot's folder
Range = Annotated[list[float], Meta(min_length=2, max_length=2)]
TORQUE_COST, FORCE_COST, NEAR_COST = 0.02, 0.02, 1.0  # of squared torque/limit, force/weight and rad
PENETRATION = 0.002  # allowed for shapes without load [m]: the depth of a soft contact
PITCH_ROOM = 0.2  # share of the pitch range kept free at both ends, for execution errors
ITERATIONS = 600
_QUIET: dict[str, Any] = {"print_time": 0, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": ITERATIONS}}
TOUCHING = 0.005  # least penetration of a collision [m]


class ContactPoints(Table, kw_only=True):
    """Contact points of a body of the left side or the middle; the right side mirrors them."""

    body: str
    points: list[Annotated[list[float], Meta(min_length=3, max_length=3)]]  # in its frame [m]
    radius: NonNegative = 0.0  # of the shape around them [m]
    friction: Positive


class PlannedPose(Table, kw_only=True):
    """Key pose. Angles are of the left side and the middle [rad]; the right side mirrors them."""

    name: str
    duration: Positive  # of the motion to the pose [s]
    hold: NonNegative = 0.0  # after arrival [s]
    pitch: Range  # of the pelvis afterwards, from and to [deg]
    near: dict[str, float] = {}  # preferred angles; default: those of the previous pose  # noqa: RUF012
    loaded: list[str] = []  # contacts with load; empty: the robot lies, and `near` is the pose  # noqa: RUF012
    touching: list[str] = []  # contacts on the floor without load  # noqa: RUF012
    com: Range | None = None  # distance of the CoM ahead of the first point of `com_of` [m]
    com_of: str = ""  # a contact
    balanced: bool = False  # with feedback during motion and hold; copied to get_up.yaml


class GetUpPlan(Table, kw_only=True):
    """``get_up_plan.yaml``."""

    moved: list[str]  # joints that the optimisation moves; the others keep the angles of the poses
    roll: Positive  # of the pelvis, at most [deg]; copied to get_up.yaml
    balance: Balance  # of the balanced poses; copied to get_up.yaml
    torque: Annotated[float, Meta(gt=0, le=1)]  # largest torque relative to the joints' limits
    margin: NonNegative  # to the joints' limits [rad]
    contacts: dict[str, ContactPoints]
    face_down: Annotated[list[PlannedPose], Meta(min_length=1)]


class NoSolutionFound(ValorError):  # noqa: N818 - a result, not a fault
    """The optimisation found no pose that fulfils the plan; names the most violated constraint."""


@dataclass(frozen=True, slots=True)
class KeyPose:
    """Solved pose."""

    plan: PlannedPose  # its specification
    coordinates: FloatArray  # (3 + m,) of a ``SagittalPosture``: x, z [m], pitch, joints [rad]
    forces: Mapping[str, FloatArray]  # contact → (k, 3) on each of its points of one side, in the world [N]
    torques: FloatArray  # (m,) [N·m]


class _Kinematics:
    """CasADi functions of the coordinates."""

    def __init__(self, posture: SagittalPosture, contacts: Mapping[str, ContactPoints]) -> None:
        z = ca.SX.sym("z", BASE + len(posture.joints))
        frames = posture.frames(z)
        com = posture.com(frames)
        self.positions: dict[str, ca.Function] = {}
        self.forces: dict[str, ca.Function] = {}
        down = ca.DM([0.0, 0.0, -1.0])
        for name, contact in contacts.items():
            position, rotation = frames[_body(posture, name, contact.body)]
            f = ca.SX.sym("f", len(contact.points), 3)
            # Lowest points of the contact's spheres in the body's frame, constant in the derivative.
            held = ca.SX.sym("held", 3, len(contact.points))
            lowest = [np.array(point) + contact.radius * rotation.T @ down for point in contact.points]
            touching = [position + rotation @ held[:, i] for i in range(len(contact.points))]
            sides = 1.0 if posture.sides.body(contact.body) == contact.body else 2.0
            work = sides * sum(f[i, :] @ point for i, point in enumerate(touching))
            effect = ca.substitute(ca.gradient(work, z), held, ca.horzcat(*lowest))
            positions = ca.substitute(ca.horzcat(*touching).T, held, ca.horzcat(*lowest))
            self.positions[name] = ca.Function("at", [z], [positions])
            self.forces[name] = ca.Function("of", [z, f], [effect])
        heights = []
        for shape in posture.shapes():
            position, rotation = frames[shape.body]
            heights += [(position + rotation @ point)[2] - shape.radius for point in shape.points]
        self.heights = ca.Function("heights", [z], [ca.vertcat(*heights)])
        self.com = ca.Function("com", [z], [com])
        self.gravity = ca.Function("gravity", [z], [ca.gradient(posture.weight * com[2], z)])


def posture_of(model: Model, plan: GetUpPlan) -> SagittalPosture:
    """Return the coordinates of a plan: the joints that it moves or names; raises ``ConfigurationError``."""
    for pose in plan.face_down:
        named = [*pose.loaded, *pose.touching, *([pose.com_of] if pose.com is not None else [])]
        if unknown := [name for name in named if name not in plan.contacts]:
            raise ConfigurationError(f"{pose.name}: unknown contact {unknown[0]!r}; expected one of {[*plan.contacts]}")
    return SagittalPosture(model, tuple(dict.fromkeys([*plan.moved, *(j for p in plan.face_down for j in p.near)])))


def find(posture: SagittalPosture, plan: GetUpPlan) -> list[KeyPose]:
    """Solve the poses that have loaded contacts; raises ``ConfigurationError``, ``NoSolutionFound``."""
    kinematics = _Kinematics(posture, plan.contacts)
    near = dict.fromkeys(posture.joints, 0.0)
    found = []
    for pose in plan.face_down:
        near |= pose.near
        if pose.loaded:
            goal = np.array([near[name] for name in posture.joints])
            found.append(_solve(posture, plan, kinematics, pose, goal))
    return found


def _solve(
    posture: SagittalPosture, plan: GetUpPlan, kinematics: _Kinematics, pose: PlannedPose, goal: FloatArray
) -> KeyPose:
    """Return the pose in equilibrium nearest to ``goal`` (m,) [rad]."""
    problem = _Problem()
    moved = np.isin(posture.joints, plan.moved)
    lower, upper = posture.limits.lower + moved * plan.margin, posture.limits.upper - moved * plan.margin
    goal = np.clip(goal, lower, upper)
    z = problem.variable(BASE + len(posture.joints), _settled(kinematics, pose, goal))
    problem.require("pelvis position", z[0], 0.0, 0.0)
    problem.require("joint limits", z[BASE:], np.where(moved, lower, goal), np.where(moved, upper, goal))
    low, high = np.radians(pose.pitch)
    room = PITCH_ROOM * (high - low)
    problem.require("pelvis pitch", z[BASE - 1], low + room, high - room)

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
        problem.require(f"{name} on the floor", kinematics.positions[name](z)[:, 2], 0.0, 0.0)
    problem.require("height above the floor", kinematics.heights(z), -PENETRATION, ca.inf)
    if pose.com is not None:
        ahead = kinematics.com(z)[0] - kinematics.positions[pose.com_of](z)[0, 0]
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
    """Optimisation with named constraints, so that a failure names the violated one."""

    def __init__(self) -> None:
        self._opti = ca.Opti()
        self._names: list[str] = []
        self.cost: Expression = 0.0

    def variable(self, shape: int | tuple[int, int], initial: FloatArray | float) -> Expression:
        """Add a variable with an initial value."""
        variable = self._opti.variable(*(shape if isinstance(shape, tuple) else (shape,)))
        self._opti.set_initial(variable, initial)
        return variable

    def require(self, name: str, expression: Expression, lower: FloatArray | float, upper: FloatArray | float) -> None:
        """Constrain each entry to its bounds."""
        rows = expression.numel()
        self._opti.subject_to(
            self._opti.bounded(np.broadcast_to(lower, rows), expression, np.broadcast_to(upper, rows))
        )
        self._names += [name] * rows

    def solve(self) -> Callable[[Expression], FloatArray]:
        """Return a function that evaluates expressions at the solution; raises ``NoSolutionFound``."""
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
    """Return the goal with the pelvis at mid-range pitch and the lowest shape on the floor."""
    z = np.concatenate([[0.0, 0.0, np.radians(np.mean(pose.pitch))], goal])
    z[1] = -float(np.min(np.array(kinematics.heights(z))))
    return z


def _body(posture: SagittalPosture, contact: str, body: str) -> int:
    try:
        return posture.model.body(body)
    except KeyError:
        raise ConfigurationError(f"contacts: {contact}: no body {body!r} in {posture.model.robot.model_file}") from None


@dataclass(frozen=True, slots=True)
class Check:
    """Result of the verification."""

    unbalanced: FloatArray  # (6,) residual force [N] and moment [N·m] on the pelvis
    torque: float  # largest torque of a joint relative to its limit
    depth: float  # of the lowest shape below the floor [m]; negative if all shapes are above
    collisions: tuple[tuple[str, str], ...]  # pairs of bodies that penetrate each other by more than 5 mm


def check(posture: SagittalPosture, contacts: Mapping[str, ContactPoints], pose: KeyPose) -> Check:
    """Apply a pose and its contact forces to both sides of the MuJoCo model."""
    model = posture.model
    mj = model.mj
    data = mujoco.MjData(mj)
    data.qpos[:] = posture.qpos(pose.coordinates)
    mujoco.mj_forward(mj, data)
    rest = data.qfrc_bias.copy()  # of gravity only; the robot is at rest
    jacobian = np.zeros((3, mj.nv))
    for name, forces in pose.forces.items():
        contact = contacts[name]
        sides = {posture.sides.body(contact.body): (1.0, -1.0, 1.0)} | {contact.body: (1.0, 1.0, 1.0)}
        for body, side in sides.items():
            number = model.body(body)
            for point, force in zip(contact.points, forces, strict=True):
                position = data.xpos[number] + data.xmat[number].reshape(3, 3) @ (np.array(point) * side)
                position[2] -= contact.radius
                mujoco.mj_jac(mj, data, jacobian, None, position, number)
                rest -= jacobian.T @ (force * side)
    shares = np.abs(rest[model.dof]) / model.robot.effort_limit[model.joint_indices]
    low = min(
        float((data.geom_xpos[g] + data.geom_xmat[g].reshape(3, 3) @ p)[2] - r)
        for g in range(mj.ngeom)
        for points, r in [ends(mj, g)]
        for p in points
    )
    return Check(rest[:6], float(shares.max()), -low, _collisions(mj, data))


def _collisions(mj: mujoco.MjModel, data: mujoco.MjData) -> tuple[tuple[str, str], ...]:
    pairs = {
        tuple(sorted(mj.body(mj.geom_bodyid[geom]).name for geom in data.contact.geom[i]))
        for i in range(data.ncon)
        if data.contact.dist[i] < -TOUCHING
    }
    return tuple(sorted((pair[0], pair[1]) for pair in pairs))
