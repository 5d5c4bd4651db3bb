"""Whole-Body Controller: torques and set-points that balance the robot (thesis 3.4.2).

Each control period: the standing reference advances; the DCM law converts the DCM error to a CoM acceleration; tasks
define the other desired accelerations; the QP solves for contact forces and joint accelerations; inverse dynamics gives
torques; joints not driven by force get set-points that integrate the accelerations.
"""

import logging
from math import sqrt

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import Locomotion
from valor.control.controller import Controller, JointCommand, JointTargets, Request
from valor.control.kinematics import Kinematics, UpperBodyKinematics, natural_frequency
from valor.control.motions import COM, FEET
from valor.control.state import RobotState
from valor.control.steps import StepSource
from valor.control.tuning_tables import Tuning, WholeBody
from valor.robot.description import RobotDescription
from valor.robot.limiter import Joints
from valor.robot.motion_tables import WHOLE_BODY
from valor.robot.size import narrowness
from valor.whole_body.balance.pelvis import PelvisReference
from valor.whole_body.balance.reference import DcmLaw
from valor.whole_body.balance.watch import BalanceWatch
from valor.whole_body.command import QpStatus, WholeBodyCommand
from valor.whole_body.constraints import FootContacts, JointLimits, SelfCollision, TorqueLimits
from valor.whole_body.desired import DesiredAccelerations
from valor.whole_body.set_points import SetPoints
from valor.whole_body.solver.elimination import UnsolvableError
from valor.whole_body.solver.qp import Bounds, ContactForceQp, Objective
from valor.whole_body.task_dynamics import TaskDynamics
from valor.whole_body.tasks import (
    ARMS,
    TASKS,
    WEIGHTS,
    AngularMomentum,
    FootMotion,
    TaskWeights,
    motions,
    nominal_weights,
)
from valor.whole_body.walking.footsteps import RecoverySteps
from valor.whole_body.walking.gait import Gait

_log = logging.getLogger(__name__)


class WholeBodyController(Controller):
    """Standing and stepping, with set-points for waist and arms."""

    name = WHOLE_BODY
    states = frozenset(state for state in Locomotion if state.balancing)
    takes_footsteps = True

    def __init__(self, robot: RobotDescription, kinematics: Kinematics) -> None:
        table, model, joints = robot.read(Tuning).whole_body, kinematics.model, kinematics.joints
        motions_of_tasks = motions(model)
        self._dynamics = TaskDynamics(kinematics, motions_of_tasks)
        force = np.array([joint.control == "force" for joint in robot.tables.joints.values()])
        self.joints = force | np.isin(np.arange(len(robot.joints)), joints.indices)
        self._force = force
        self._asked_gains: tuple[FloatArray, FloatArray] | None = None
        self._table = table
        self._joints = joints
        self._effort_limit = robot.effort_limit
        self._servo_damping = robot.servo_damping
        self._upper_body = UpperBodyKinematics(model)
        gravity = -float(model.mj.opt.gravity[2])
        omega = natural_frequency(self._upper_body.nominal_com_height, gravity)
        law = _law(table, omega, gravity)
        self.pelvis = PelvisReference(model, joints.group("left_leg", "right_leg"))  # commanded pelvis pose
        self._set_points = SetPoints(robot, joints)
        tasks = [task(robot) for task in TASKS]
        limits = JointLimits(robot, table, joints.places)
        self._desired = DesiredAccelerations(
            robot,
            self._dynamics,
            tasks,
            motions=motions_of_tasks,
            limits=limits,
            law=law,
            upper_body=self._upper_body,
            pelvis=self.pelvis,
            set_points=self._set_points,
        )
        self._objective = Objective(tasks, motions_of_tasks, joints)
        self.weights = TaskWeights(nominal_weights(table), robot.tables.weight_factor, robot.control_period)
        self._gait = Gait(robot, omega, self._upper_body.nominal_com_height)
        self._weight = float(model.mj.body_subtreemass[model.body(robot.tables.base)]) * gravity
        self._per_momentum = omega / self._weight  # displacement of the DCM per angular momentum [1/(N·s)]
        # Swing foot in the objective, whether the robot recovers, whether it stands and may not step
        self._mode: tuple[int | None, bool, bool] = (None, False, False)
        self._foot_weights = robot.tables.walking.foot_weight, robot.read(Tuning).disturbance.recovery_foot_weight
        feet = robot.tables.feet
        self._narrow = narrowness(robot.tables.size.leg, min(feet.left.half_width, feet.right.half_width))
        self.may_recover = True  # whether the robot may step automatically to keep its balance
        self.watch = BalanceWatch(robot)  # trigger of such steps, with its reason
        self._recovers = robot.read(Tuning).disturbance.step_when_standing
        self._recovery = RecoverySteps(robot)
        self._contacts = FootContacts(robot, model.mj.nv)
        effort: FloatArray = robot.effort_limit[joints.places]
        self._joint_bounds = Bounds(  # without self-collision
            np.concatenate((-effort, np.zeros(joints.count))), np.concatenate((effort, np.zeros(joints.count)))
        )
        self._soles = motions_of_tasks.rows[FEET]
        self._momentum = motions_of_tasks.rows[AngularMomentum.name]
        self.collision = SelfCollision(model)  # its ``rows`` are the pairs of bodies near each other
        self._load = (1.0, 1.0)
        self._qp = ContactForceQp(
            self._contacts.count, joints.count, (TorqueLimits(model.mj.dof_damping[6:].copy()), limits)
        )
        self._effort = np.zeros(len(robot.joints))  # last feasible
        self._forces = np.zeros(2)
        self._frozen: Joints | None = None  # in the objective
        self.qp_failures = 0  # periods without a solution since construction
        self._weigh()

    @property
    def at_rest(self) -> bool:
        """False if a gait is active, from the first transfer of weight to rest."""
        return not self._gait.active

    @property
    def swinging(self) -> int | None:
        """Foot in the air, or None."""
        return self._gait.swinging

    @property
    def recovering(self) -> bool:
        """True if the robot takes automatic steps to keep its balance."""
        return self._gait.active and self._gait.source is self._recovery

    def footholds(self, state: RobotState) -> tuple[FloatArray, FloatArray] | None:
        """(2, 3) positions [m] and (2, 3, 3) rotations of soles after the step under way; None if both stand."""
        foot, foothold = self._gait.stepping, self._gait.foothold
        if foot is None or foothold is None:
            return None
        positions, rotations = state.sole_positions_in_odom.copy(), state.sole_rotations_in_odom.copy()
        positions[foot], rotations[foot] = foothold.position, foothold.rotation
        return positions, rotations

    def begin(self, state: RobotState, last: JointCommand | None = None) -> None:
        """Start to stand from ``state`` without a jump: references start there and blend to nominal."""
        self._dynamics.evaluate()
        position = state.joint_position[self._joints.places].copy()
        self._upper_body.update(position)
        self.weights.reset()
        self._weigh()
        self._gait.stop()
        self.watch.reset()
        self._desired.reset(state)
        self._set_points.reset(position)
        self._effort = np.clip(state.joint_effort, -self._effort_limit, self._effort_limit)
        self._forces = state.foot_forces.copy()

    def catch(self, state: RobotState) -> None:
        """After ``begin``: lower a foot in the air where the DCM needs it, then stand."""
        foot = int(state.foot_forces.argmin())
        if not state.contacts[foot]:
            self._gait.catch(state, self._recovery, foot, state.dcm_in_odom - self._desired.shift)

    def end(self) -> None:
        """Give up control of the legs: discard the gait, and what its source knows of it."""
        if self._gait.active:
            self._gait.source.rested()
        self._gait.stop()

    def update(self, state: RobotState, request: Request, dt: float) -> WholeBodyCommand:
        """Compute one control period of ``dt`` [s]; steps are those of the request in which a gait starts."""
        dynamics, desired, objective, reference = self._dynamics, self._desired, self._objective, request.joints
        dynamics.evaluate()
        self._set_gains(reference)
        self._upper_body.update(reference.position[self._joints.places])
        self.pelvis.advance(1e-9 * state.time, dt)
        changed = self.weights.advance()
        self._step(state, request.steps, dt)
        steps = self._gait.active or (self._recovers and self.may_recover)
        mode = self._gait.swinging, self.recovering, not steps
        if changed or mode != self._mode or reference.frozen is not self._frozen:
            self._frozen = reference.frozen
            self._weigh(*mode)
        desired.update(state, self._gait, reference, dt)
        try:
            bounds = self._bounds(state)
            objective.update(dynamics, desired.acceleration, desired.posture)
            self._contacts.update(dynamics.jacobian[self._soles], dynamics.sole_rotation)
            solution = self._qp.solve(objective, dynamics, self._contacts.forces, bounds)
        except UnsolvableError as error:
            return self._last_feasible(state, str(error))
        self._forces = self._contacts.vertical_forces(solution.rho)
        command = self._command(state, solution.acceleration, solution.torque, dt, solution.status)
        self._effort = command.effort
        return command

    def _step(self, state: RobotState, steps: StepSource | None, dt: float) -> None:
        gait, reference = self._gait, self._desired
        dcm = self._recovery.dcm = state.dcm_in_odom - reference.shift
        if self._recovers and self.may_recover and gait.resting and self.watch.update(state, reference.dcm):
            self.pelvis.go_home()
            gait.recover(state, self._recovery, dcm, reference.centre_vrp, self.watch.velocity)
        if gait.active:
            gait.update(state, reference.shift - self._turning(), dt)
        elif steps is not None and self.pelvis.resting:
            gait.start(state, steps, reference.centre_dcm, reference.centre_vrp)
        left, right = gait.load.tolist()
        if (left, right) != self._load:
            self._load = (left, right)
            self._qp.limit_forces(self._contacts.upper(self._load, self._weight))

    def _turning(self) -> FloatArray:
        """(3,) displacement of the DCM by stopping what turns: −∫(k̇_y, −k̇_x)·ω/(m·g)·dt, k about the CoM [m]."""
        x, y, _ = self._dynamics.task_velocity[self._momentum].tolist()
        return np.array((y * self._per_momentum, -x * self._per_momentum, 0.0))

    def _set_gains(self, asked: JointTargets) -> None:
        """Those asked for; none for joints driven by force."""
        before = self._asked_gains
        if before is None or before[0] is not asked.stiffness or before[1] is not asked.damping:
            self._asked_gains = asked.stiffness, asked.damping
            self._stiffness = np.where(self._force, 0.0, asked.stiffness)
            self._damping = np.where(self._force, 0.0, asked.damping)

    def _weigh(self, swinging: int | None = None, recovers: bool = False, stays: bool = False) -> None:
        self._mode = swinging, recovers, stays
        swing = None if swinging is None else (swinging, self._foot_weights[recovers])
        frozen = None if self._frozen is None else self._frozen[self._joints.places]
        weights = dict(zip(WEIGHTS, self.weights.values.tolist(), strict=True))
        if recovers:  # a narrow sole mends little of what swinging a leg and righting the trunk cost the CoM
            weights[COM] /= self._narrow**2
        if swinging is not None:
            weights[ARMS] *= self._table.arm_swing_factor
        if stays:
            for name in (COM, FootMotion.weight):
                weights[name] *= self._table.fixed_feet_factor
        self._objective.weigh(weights, swing, frozen)

    def _bounds(self, state: RobotState) -> Bounds:
        own, desired, n = self._joint_bounds, self._desired, self._joints.count
        own.lower[n:], own.upper[n:] = desired.lower, desired.upper
        limit = self.collision.update(self._dynamics, desired.velocity, state.time)
        if limit is None:
            return own
        lower = self.collision.lower
        unbounded = np.full(lower.size, np.inf)
        return Bounds(np.concatenate((own.lower, lower)), np.concatenate((own.upper, unbounded)), limit)

    def _last_feasible(self, state: RobotState, reason: str) -> WholeBodyCommand:
        if self.qp_failures == 0:
            _log.warning("whole-body QP not solved (%s); repeating the last torques, with damping", reason)
        self.qp_failures += 1
        places, joints = self._joints.places, self._joints.count
        damped = self._effort[places] - self._servo_damping[places] * state.joint_velocity[places]
        limit = self._effort_limit[places]
        torque = np.nan_to_num(np.clip(damped, -limit, limit))
        self._set_points.velocity[:] = 0.0
        return self._command(state, np.zeros(6 + joints), torque, 0.0, QpStatus.INFEASIBLE)

    def _command(
        self, state: RobotState, acceleration: FloatArray, torque: FloatArray, dt: float, status: QpStatus
    ) -> WholeBodyCommand:
        outputs = self._set_points.advance(acceleration, torque, state.joint_position, dt)
        effort, joint_acceleration, position, velocity = outputs
        return WholeBodyCommand(
            position=position,
            velocity=velocity,
            effort=effort,
            stiffness=self._stiffness,
            damping=self._damping,
            acceleration=joint_acceleration,
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
