"""The Whole-Body Controller: torques and set-points that balance the robot (thesis 3.4.2).

Each control period: the reference of standing goes on; the DCM law turns the DCM's error into the CoM's acceleration;
orientation, foot and posture tasks say what else is wanted; the QP finds contact forces and joint accelerations; the
inverse dynamics gives torques; joints that are not driven by force get set-points that integrate the accelerations.
"""

from __future__ import annotations

import logging
from math import sqrt

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.whole_body.balance.dcm import DcmLaw
from valor.whole_body.balance.pelvis import PelvisReference
from valor.whole_body.constraints.contact import FootContacts
from valor.whole_body.constraints.joint_limits import JointLimits
from valor.whole_body.constraints.self_collision import SelfCollision
from valor.whole_body.constraints.torque_limits import TorqueLimits
from valor.whole_body.model.arms import UpperBodyKinematics
from valor.whole_body.model.dynamics import ModelJoints
from valor.whole_body.model.motion import FEET
from valor.whole_body.set_points import SetPoints
from valor.whole_body.solver.elimination import UnsolvableError
from valor.whole_body.solver.objective import Objective
from valor.whole_body.solver.qp import Bounds, ContactForceQp, Solution
from valor.whole_body.state import QpStatus, RobotState, UpperBodyReference, WholeBodyCommand
from valor.whole_body.tasks.desired import DesiredAccelerations
from valor.whole_body.tasks.table import TASKS, WEIGHTS, motions, nominal_weights
from valor.whole_body.tasks.weights import TaskWeights
from valor.whole_body.tuning_tables import Tuning, WholeBody
from valor.whole_body.walking.footsteps import StepSource
from valor.whole_body.walking.gait import Gait
from valor.whole_body.walking.recovery import BalanceWatch, RecoverySteps

_log = logging.getLogger(__name__)


class WholeBodyController:
    """Standing and stepping, with set-points for waist and arms.

    Attributes:
        step_source: where steps come from; None: the robot stands. A gait ends with the source it began with.
        may_recover: whether the robot may step on its own accord, when its feet alone cannot hold it.
        watch: when it did, and why.
        pelvis: where the pelvis shall be, led from outside.
        weights: of the tasks.
        integral: (3,) of the DCM law [m]: what the model has wrong.
        qp_failures: periods without a solution since the controller was made.
    """

    def __init__(self, robot: RobotDescription, model: Model) -> None:
        table = robot.read(Tuning).whole_body
        joints = ModelJoints(model)
        self._table = table
        self._joints = joints
        self._count = len(robot.joints)
        self._effort_limit = robot.effort_limit
        self._servo_damping = robot.servo_damping
        self._lower, self._upper = robot.lower[joints.places], robot.upper[joints.places]
        self._upper_body = UpperBodyKinematics(model)
        gravity = -float(model.mj.opt.gravity[2])
        omega = DcmLaw.natural_frequency(self._upper_body.nominal_com_height, gravity)
        law = _law(table, omega, gravity)
        legs = joints.group("left_leg", "right_leg")
        self.pelvis = PelvisReference(model, legs)
        self._set_points = SetPoints(robot, joints)
        tasks, motions_of_tasks = [task(robot) for task in TASKS], motions(model)
        limits = JointLimits(robot, table, joints.places)
        self._desired = DesiredAccelerations(
            robot,
            joints,
            tasks=tasks,
            motions=motions_of_tasks,
            limits=limits,
            law=law,
            upper_body=self._upper_body,
            pelvis=self.pelvis,
            legs=legs.tolist(),
            set_points=self._set_points,
        )
        self._objective = Objective(tasks, motions_of_tasks, joints)
        self.weights = TaskWeights(nominal_weights(table), robot.tables.weight_factor, robot.control_period)
        self._gait = Gait(robot, omega, self._upper_body.nominal_com_height)
        self._weight = float(model.mj.body_subtreemass[model.body(robot.tables.base)]) * gravity
        self._swung: int | None = None  # the foot that the objective knows to swing
        self.step_source: StepSource | None = None
        self.may_recover = True
        self.watch = BalanceWatch(robot)
        self._recovers = robot.read(Tuning).disturbance.step_when_standing
        self._recovery = RecoverySteps(robot)
        self._contacts = FootContacts(robot, model.mj.nv)
        effort: FloatArray = robot.effort_limit[joints.places]
        self._joint_bounds = Bounds(  # without those of parts that are near
            np.concatenate((-effort, np.zeros(joints.count))), np.concatenate((effort, np.zeros(joints.count)))
        )
        self._soles = motions_of_tasks.rows[FEET]
        self._collision = SelfCollision(model)
        self._load = (1.0, 1.0)
        self._qp = ContactForceQp(
            self._contacts.count, joints.count, (TorqueLimits(model.mj.dof_damping[6:].copy()), limits)
        )
        self._effort = np.zeros(self._count)  # last feasible
        self._forces = np.zeros(2)
        self.qp_failures = 0
        self._weigh(None)

    @property
    def stepping(self) -> bool:
        """Whether the robot is not at rest on both feet, but between steps."""
        return self._gait.active

    @property
    def swinging(self) -> int | None:
        """The foot in the air, or None."""
        return self._gait.swinging

    @property
    def recovering(self) -> bool:
        """Whether the robot takes steps that nobody asked for, to keep its balance."""
        return self._gait.active and self._gait.source is self._recovery

    def footholds(self, state: RobotState) -> tuple[FloatArray, FloatArray] | None:
        """(2, 3) and (2, 3, 3) of the soles where they stand or will come down; None: they stand."""
        foot, foothold = self._gait.stepping, self._gait.foothold
        if foot is None or foothold is None:
            return None
        positions, rotations = state.sole_positions_in_odom.copy(), state.sole_rotations_in_odom.copy()
        positions[foot], rotations[foot] = foothold.position, foothold.rotation
        return positions, rotations

    @property
    def near_pairs(self) -> int:
        """How many pairs of the robot's parts are so near that they are kept apart."""
        return self._collision.rows

    @property
    def integral(self) -> FloatArray:
        """(3,) of the DCM law [m]."""
        return self._desired.integral

    def reset(self, state: RobotState) -> None:
        """Begin to stand from ``state`` without a jump: references start there and go to nominal."""
        position = state.joint_position[self._joints.places].copy()
        self._upper_body.update(position)
        self.weights.reset()
        self._weigh(None)
        self._gait.stop()
        self._desired.reset(state)
        self._set_points.reset(position)
        self._effort = np.clip(state.joint_effort, -self._effort_limit, self._effort_limit)
        self._forces = state.foot_forces.copy()

    def catch(self, state: RobotState) -> None:
        """After ``reset``: a foot that is found in the air comes down where the DCM needs it, and the robot stands."""
        foot = int(state.foot_forces.argmin())
        if not state.contacts[foot]:
            self._gait.catch(state, self._recovery, foot, state.dcm_in_odom - self._desired.shift)

    def leave(self) -> None:
        """Somebody else has the legs: what had begun is forgotten."""
        self._gait.stop()
        self.step_source = None

    def update(self, state: RobotState, reference: UpperBodyReference, dt: float) -> WholeBodyCommand:
        """One control period.

        Args:
            state: the estimate; its ``dynamics`` are at it.
            reference: of waist and arms.
            dt: since the last period [s].
        """
        dynamics, desired, objective = state.dynamics, self._desired, self._objective
        self._upper_body.update(reference.position[self._joints.places])
        self.pelvis.advance(1e-9 * state.time, dt)
        changed = self.weights.advance()
        self._step(state, dt)
        if changed or self._gait.swinging != self._swung:
            self._weigh(self._gait.swinging)
        desired.update(state, self._gait, reference, dt)
        try:
            bounds = self._bounds(state)
            objective.update(dynamics, desired.acceleration, desired.posture)
            self._contacts.update(dynamics.jacobian[self._soles], dynamics.sole_rotation)
            solution = self._qp.solve(objective, dynamics, self._contacts.forces, bounds)
        except UnsolvableError as error:
            return self._last_feasible(state, str(error))
        return self._command(state, solution, dt)

    def _step(self, state: RobotState, dt: float) -> None:
        """Let the gait go on, or begin if there are steps to take."""
        gait, reference = self._gait, self._desired
        if self._recovers and self.may_recover and gait.resting and self.watch.update(state, reference.dcm):
            self.pelvis.go_home()
            gait.recover(state, self._recovery, state.dcm_in_odom - reference.shift, reference.centre_vrp)
        if gait.active:
            gait.update(state, state.dcm_in_odom - reference.shift, dt)
        elif self.step_source is not None and self.pelvis.resting:
            gait.start(state, self.step_source, reference.centre_dcm, reference.centre_vrp)
        left, right = gait.load.tolist()
        if (left, right) != self._load:
            self._load = (left, right)
            self._qp.limit_forces(self._contacts.upper(self._load, self._weight))

    def _weigh(self, swinging: int | None) -> None:
        self._swung = swinging
        self._objective.weigh(dict(zip(WEIGHTS, self.weights.values.tolist(), strict=True)), swinging)

    def _bounds(self, state: RobotState) -> Bounds:
        """Those of the joints, and those of parts of the robot that are near each other."""
        own, desired, n = self._joint_bounds, self._desired, self._joints.count
        own.lower[n:], own.upper[n:] = desired.lower, desired.upper
        limit = self._collision.update(state.dynamics, desired.velocity, state.time)
        if limit is None:
            return own
        lower = self._collision.lower
        unbounded = np.full(lower.size, np.inf)
        return Bounds(np.concatenate((own.lower, lower)), np.concatenate((own.upper, unbounded)), limit)

    def _command(self, state: RobotState, solution: Solution, dt: float) -> WholeBodyCommand:
        told = self._set_points.advance(solution.acceleration, solution.torque, state.joint_position, dt)
        self._effort = told[0]
        self._forces = self._contacts.vertical_forces(solution.rho)
        return self._tell(told, solution.status)

    def _last_feasible(self, state: RobotState, reason: str) -> WholeBodyCommand:
        """The last feasible torques, with the joints' motion damped and the set-points standing still."""
        if self.qp_failures == 0:
            _log.warning("whole-body QP not solved (%s); going on with the last torques, damped", reason)
        self.qp_failures += 1
        places, joints = self._joints.places, self._joints.count
        damped = self._effort[places] - self._servo_damping[places] * state.joint_velocity[places]
        limit = self._effort_limit[places]
        torque = np.nan_to_num(np.clip(damped, -limit, limit))
        self._set_points.velocity[:] = 0.0
        told = self._set_points.advance(np.zeros(6 + joints), torque, state.joint_position, 0.0)
        return self._tell(told, QpStatus.INFEASIBLE)

    def _tell(self, told: tuple[FloatArray, FloatArray, FloatArray, FloatArray], status: QpStatus) -> WholeBodyCommand:
        effort, acceleration, position, velocity = told
        return WholeBodyCommand(
            effort=effort,
            acceleration=acceleration,
            position=position,
            velocity=velocity,
            dcm_reference_in_odom=self._desired.dcm,
            desired_foot_forces=self._forces,
            qp_status=status,
            qp_failures=self.qp_failures,
        )


def _law(table: WholeBody, omega: float, gravity: float) -> DcmLaw:
    return DcmLaw(
        omega,
        table.dcm_gain,
        table.dcm_integral_gain,
        table.dcm_integral_limit,
        table.dcm_integral_error,
        push_gain=table.dcm_push_gain,
        push_error=table.dcm_push_error,
        grip=table.friction / sqrt(2.0) * gravity,
    )
