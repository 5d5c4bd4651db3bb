"""The Whole-Body Controller: torques and set-points that balance the robot (thesis 3.4.2).

Each control period: the reference of standing goes on; the DCM law turns the DCM's error into the CoM's acceleration;
orientation, foot and posture tasks say what else is wanted; the QP finds contact forces and joint accelerations; the
inverse dynamics gives torques; joints that are not driven by force get set-points that integrate the accelerations.
"""

from __future__ import annotations

import logging

import numpy as np

from motion_manager.whole_body import rotation
from motion_manager.whole_body.arms import UpperBodyKinematics
from motion_manager.whole_body.contact import FootContacts
from motion_manager.whole_body.dcm import DcmLaw
from motion_manager.whole_body.dynamics import CHEST, COM, MOMENTUM, PELVIS, ROWS, SOLES, ModelJoints, sole_rows
from motion_manager.whole_body.elimination import UnsolvableError
from motion_manager.whole_body.limits import JointLimits
from motion_manager.whole_body.pelvis import PelvisReference
from motion_manager.whole_body.qp import Bounds, ContactForceQp, Solution
from motion_manager.whole_body.reference import StandReference
from motion_manager.whole_body.self_collision import SelfCollision
from motion_manager.whole_body.stance import Stance
from motion_manager.whole_body.state import (
    FloatArray,
    QpStatus,
    RobotState,
    UpperBodyReference,
    WholeBodyCommand,
)
from motion_manager.whole_body.tasks import Objective
from motion_manager.whole_body.walking.footsteps import StepSource
from motion_manager.whole_body.walking.gait import Gait
from motion_manager.whole_body.walking.recovery import BalanceWatch, RecoverySteps
from motion_manager.whole_body.weights import TaskWeights
from valor_common.model import Model
from valor_common.robot import RobotDescription

_log = logging.getLogger(__name__)

CATCH_UP = 0.5  # of its velocity limit, at which a joint's set-point makes up for a distant reference at most


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
        table = robot.tables.whole_body
        joints = ModelJoints(model)
        self._table = table
        self._joints = joints
        self._count = len(robot.joints)
        self._effort_limit = robot.effort_limit
        self._servo_damping = robot.servo_damping
        self._lower, self._upper = robot.lower[joints.places], robot.upper[joints.places]
        self._upper_body = UpperBodyKinematics(model)
        omega = DcmLaw.natural_frequency(self._upper_body.nominal_com_height, -float(model.mj.opt.gravity[2]))
        self._law = DcmLaw(
            omega,
            table.dcm_gain,
            table.dcm_integral_gain,
            table.dcm_integral_limit,
            table.dcm_integral_error,
        )
        self._legs = joints.group("left_leg", "right_leg")
        self.pelvis = PelvisReference(model, self._legs)
        self._reference = StandReference(model, omega, self._upper_body, self.pelvis)
        self._objective = Objective(table, joints)
        self.weights = TaskWeights(table, robot.tables.weight_factor, robot.control_period)
        self._gait = Gait(robot, omega, self._upper_body.nominal_com_height)
        self._weight = float(model.mj.body_subtreemass[model.body(robot.tables.base)]) * -float(model.mj.opt.gravity[2])
        self._walking = robot.tables.walking
        self.step_source: StepSource | None = None
        self.may_recover = True
        self.watch = BalanceWatch(robot)
        self._recovers = robot.tables.disturbance.step_when_standing
        self._recovery = RecoverySteps(robot)
        self._damping = np.zeros(ROWS)  # of the operational velocities
        self._damping[MOMENTUM] = -table.angular_momentum_gain
        self._damping[CHEST] = self._damping[PELVIS] = -table.orientation_damping
        self._damping[SOLES] = -table.foot_damping
        self._moves_with_pelvis = np.zeros((ROWS, 3))  # what the pelvis' linear velocity adds to them
        for first in (0, 12, 18):
            self._moves_with_pelvis[first : first + 3] = np.eye(3)
        self._contacts = FootContacts(robot, model.mj.nv)
        self._limits = JointLimits(robot, table, joints.places)
        self._bounds = Bounds(
            np.concatenate((-self._limits.effort, np.zeros(joints.count))),
            np.concatenate((self._limits.effort, np.zeros(joints.count))),
        )
        self._joint_bounds = self._bounds  # without those of parts that are near
        self._collision = SelfCollision(model)
        self._stance = Stance(table.stance_stiffness)
        self._load = (1.0, 1.0)
        self._qp = ContactForceQp(self._contacts.count, model.mj.dof_damping[6:].copy())
        self._integrated = np.array([robot.tables.joints[name].control != "force" for name in joints.names])
        self._integrated_places = np.arange(self._count)[joints.places][self._integrated]
        self._catch_up = CATCH_UP * robot.velocity_limit[joints.places]
        self._position = np.zeros(joints.count)  # set-points, of integrated joints
        self._velocity = np.zeros(joints.count)
        self._leg_start = np.zeros(len(self._legs))
        self._effort = np.zeros(self._count)  # last feasible
        self._forces = np.zeros(2)
        self.qp_failures = 0

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
        return self._law.integral

    def reset(self, state: RobotState) -> None:
        """Begin to stand from ``state`` without a jump: references start there and go to nominal."""
        position = state.joint_position[self._joints.places].copy()
        self._upper_body.update(position)
        self._law.reset()
        self.weights.reset()
        self._objective.weigh(self.weights.values)
        self._stance.reset(state)
        self._gait.stop()
        self._reference.reset(state)
        self._leg_start = position[self._legs]
        self._position[:] = np.clip(position, self._lower, self._upper)
        self._velocity[:] = 0.0
        self._effort = np.clip(state.joint_effort, -self._effort_limit, self._effort_limit)
        self._forces = state.foot_forces.copy()

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
        places, dynamics = self._joints.places, state.dynamics
        position, velocity = dynamics.joint_position.copy(), dynamics.joint_velocity.copy()
        np.copyto(position, self._position, where=self._integrated)
        np.copyto(velocity, self._velocity, where=self._integrated)
        wanted = reference.position[places].copy()
        self._upper_body.update(wanted)
        self.pelvis.advance(1e-9 * state.time, dt)
        if self.weights.advance():
            self._objective.weigh(self.weights.values)
        self._step(state, dt)
        self._reference.update(state, dt, (self._gait.dcm, self._gait.vrp) if self._gait.active else None)
        self._operational_tasks(state, dt)
        self._posture_tasks(position, velocity, wanted, reference)
        n = self._joints.count
        own = self._joint_bounds
        own.lower[n:], own.upper[n:] = self._limits.acceleration(position, velocity)
        try:
            self._keep_apart(state, velocity)
            self._objective.update(dynamics)
            self._contacts.update(dynamics.jacobian[SOLES], dynamics.sole_rotation)
            solution = self._qp.solve(self._objective, dynamics, self._contacts.forces, self._bounds)
        except UnsolvableError as error:
            return self._last_feasible(state, str(error))
        return self._command(state, solution, dt)

    def _step(self, state: RobotState, dt: float) -> None:
        """Let the gait go on, or begin if there are steps to take."""
        gait, reference = self._gait, self._reference
        if self._recovers and self.may_recover and gait.resting and self.watch.update(state, reference.dcm):
            self.pelvis.go_home()
            gait.recover(state, self._recovery, state.dcm_in_odom - reference.shift, reference.centre_vrp)
        if gait.active:
            gait.update(state, state.dcm_in_odom - reference.shift, dt)
            self._stance.reset(state)
        elif self.step_source is not None and self.pelvis.resting:
            gait.start(state, self.step_source, reference.centre_dcm, reference.centre_vrp)
        self._objective.swing(gait.swinging, self._walking.foot_weight)
        left, right = gait.load.tolist()
        if (left, right) != self._load:
            self._load = (left, right)
            self._qp.limit_forces(self._contacts.upper(self._load, self._weight))

    def _swing_task(self, state: RobotState, velocity: FloatArray) -> None:
        """The swinging sole: a_ref + k_p·(x_ref − x) + k_d·(v_ref − v)."""
        foot, wanted = self._gait.swinging, self._objective.acceleration
        if foot is None:
            return
        point, table = self._gait.swing, self._walking
        rows = sole_rows(foot)
        error = np.empty(6)
        np.subtract(point.position, state.sole_positions_in_odom[foot], out=error[:3])
        error[3:] = rotation.error(point.rotation, state.sole_rotations_in_odom[foot])
        wanted[rows] = point.acceleration
        wanted[rows] += table.foot_stiffness * error
        wanted[rows] += table.foot_damping * (point.velocity - velocity[rows])

    def _operational_tasks(self, state: RobotState, dt: float) -> None:
        """The CoM by the DCM law; orientations k_p·e − k_d·ω; momentum and feet damped."""
        reference, dynamics, wanted = self._reference, state.dynamics, self._objective.acceleration
        velocity = self._moves_with_pelvis @ state.pelvis_linear_velocity_in_odom
        velocity += dynamics.task_velocity
        np.multiply(velocity, self._damping, out=wanted)
        point = self._law.repellent_point(state.dcm_in_odom, reference.dcm, reference.vrp, dt)
        wanted[COM] = self._law.acceleration(state.com_in_odom, point)
        stiffness = self._table.orientation_stiffness
        wanted[CHEST] += stiffness * rotation.error(reference.chest, dynamics.chest_rotation)
        wanted[PELVIS] += stiffness * rotation.error(reference.pelvis, dynamics.rotation)
        turning = self._table.orientation_damping * reference.turning
        wanted[CHEST] += turning
        wanted[PELVIS] += turning
        if not self._gait.active:
            self._stance.hold(state, wanted[SOLES])
        self._swing_task(state, velocity)

    def _posture_tasks(
        self, position: FloatArray, velocity: FloatArray, wanted: FloatArray, reference: UpperBodyReference
    ) -> None:
        """Joint accelerations q̈_ref + k_d·(q̇_ref + clip(k_p/k_d·(q_ref − q)) − q̇)."""
        table, places, legs = self._table, self._joints.places, self._legs
        rate, acceleration = reference.velocity[places].copy(), reference.acceleration[places].copy()
        s = self._reference.legs_blend
        wanted[legs] = self._leg_start + s * (self.pelvis.legs - self._leg_start)
        rate[legs] = 0.0
        acceleration[legs] = 0.0
        wanted -= position
        wanted *= table.posture_stiffness / table.posture_damping
        np.minimum(wanted, self._catch_up, out=wanted)
        np.maximum(wanted, -self._catch_up, out=wanted)
        wanted += rate
        wanted -= velocity
        wanted *= table.posture_damping
        wanted += acceleration
        self._objective.posture[:] = wanted

    def _keep_apart(self, state: RobotState, velocity: FloatArray) -> None:
        """Bounds of parts of the robot that are near each other join those of the joints."""
        self._bounds = own = self._joint_bounds
        limit = self._collision.update(state.dynamics, velocity, state.time)
        if limit is not None:
            lower = self._collision.lower
            unbounded = np.full(lower.size, np.inf)
            self._bounds = Bounds(np.concatenate((own.lower, lower)), np.concatenate((own.upper, unbounded)), limit)

    def _command(self, state: RobotState, solution: Solution, dt: float) -> WholeBodyCommand:
        places, joint_acceleration = self._joints.places, solution.acceleration[6:]
        self._velocity += joint_acceleration * dt
        self._position += self._velocity * dt
        np.clip(self._position, self._lower, self._upper, out=self._position)
        effort, acceleration = np.zeros(self._count), np.zeros(self._count)
        effort[places] = solution.torque
        acceleration[places] = joint_acceleration
        self._effort = effort
        self._forces = self._contacts.vertical_forces(solution.rho)
        return self._with_set_points(state, effort, acceleration, solution.status)

    def _last_feasible(self, state: RobotState, reason: str) -> WholeBodyCommand:
        """The last feasible torques, with the joints' motion damped and the set-points standing still."""
        if self.qp_failures == 0:
            _log.warning("whole-body QP not solved (%s); going on with the last torques, damped", reason)
        self.qp_failures += 1
        self._velocity[:] = 0.0
        effort = np.zeros(self._count)
        places = self._joints.places
        damped = self._effort[places] - self._servo_damping[places] * state.joint_velocity[places]
        limit = self._effort_limit[places]
        effort[places] = np.nan_to_num(np.clip(damped, -limit, limit))
        return self._with_set_points(state, effort, np.zeros(self._count), QpStatus.INFEASIBLE)

    def _with_set_points(
        self, state: RobotState, effort: FloatArray, acceleration: FloatArray, status: QpStatus
    ) -> WholeBodyCommand:
        position, velocity = state.joint_position.copy(), np.zeros(self._count)
        position[self._integrated_places] = self._position[self._integrated]
        velocity[self._integrated_places] = self._velocity[self._integrated]
        return WholeBodyCommand(
            effort=effort,
            acceleration=acceleration,
            position=position,
            velocity=velocity,
            dcm_reference_in_odom=self._reference.dcm,
            desired_foot_forces=self._forces,
            qp_status=status,
            qp_failures=self.qp_failures,
        )
