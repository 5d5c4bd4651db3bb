"""Desired accelerations of a period, in one kernel: references, tasks, posture and joint limits."""

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from valor.common.kernel import Expression, Kernel, by_rows, pieces
from valor.control.controller import JointTargets
from valor.control.kinematics import UpperBodyKinematics
from valor.control.motions import Motions
from valor.control.state import RobotState
from valor.robot.description import RobotDescription
from valor.whole_body.balance.pelvis import PelvisReference
from valor.whole_body.balance.reference import Begun, DcmLaw, Feet, Led, StandReference, at_frequency
from valor.whole_body.constraints import JointLimits
from valor.whole_body.set_points import SetPoints
from valor.whole_body.task_dynamics import TaskDynamics
from valor.whole_body.tasks import SWING, ChestOrientation, Period, Posture, Task, stance
from valor.whole_body.walking.gait import Gait

_MEMORY = (1, 3, 9, 9, 3, 3)  # sizes of ``Begun``, the law's integral, the stance held
_SHIFT = slice(4, 7)  # first row of ``Begun.shift`` in it


class DesiredAccelerations:
    """Desired accelerations, and the references behind them."""

    def __init__(
        self,
        robot: RobotDescription,
        dynamics: TaskDynamics,
        tasks: Sequence[Task],
        *,
        motions: Motions,
        limits: JointLimits,
        law: DcmLaw,
        upper_body: UpperBodyKinematics,
        pelvis: PelvisReference,
        set_points: SetPoints,
    ) -> None:
        joints = dynamics.joints
        nj = joints.count
        self._dynamics = dynamics
        self._tasks, self._motions, self._law, self._limits = tasks, motions, law, limits
        self._places, self._legs = joints.places, joints.group("left_leg", "right_leg").tolist()
        self._integrated = set_points.integrated
        self._pelvis, self._upper_body = pelvis, upper_body
        self._reference = StandReference(robot, upper_body.nominal_com_height)
        self._posture = Posture(robot, joints.places, self._legs)
        # Positions and rotations of soles, CoM, DCM, pelvis velocity; velocities and poses of the motions.
        self._sizes = (6, 18, 3, 3, 3, motions.count, motions.size)
        self._state = np.zeros(sum(self._sizes))
        self._memory, self._next = np.zeros(sum(_MEMORY)), np.zeros(sum(_MEMORY))
        self._led = np.zeros(15)
        self._legs_led, self._legs_start = np.zeros(len(self._legs)), np.zeros(len(self._legs))
        self._gait = np.zeros(9)  # whether the robot steps, DCM, VRP, ω, ω̇
        self._swing = np.zeros(2 + sum(SWING))  # which foot swings, then its reference
        self._asked = np.zeros((3, nj))
        self._measured = np.zeros((2, nj))
        self._dt = np.zeros(1)
        self.acceleration, self.posture = np.zeros(motions.count), np.zeros(nj)  # of motions; of joints [rad/s²]
        self.lower, self.upper = np.zeros(nj), np.zeros(nj)  # limits of joint accelerations [rad/s²]
        self.velocity = np.zeros(nj)  # joint velocity that the QP's accelerations change [rad/s]
        self._sent = np.zeros((4, 3))
        # DCM reference for nominal ω, part of it due to arms that are not nominal, references for nominal arms [m]
        self.dcm = self.shift = self.centre_dcm = self.centre_vrp = np.zeros(3)
        inputs = (
            *(self._state, self._memory, self._led, upper_body.com, upper_body.chest, self._legs_led),
            *(self._legs_start, self._gait, self._swing, self._asked, self._measured),
            *(set_points.position, set_points.velocity, self._dt),
        )
        sent = self._sent, self.acceleration, self.posture, self.lower, self.upper, self.velocity
        self._evaluate = Kernel("desired", self._expressions, inputs, (self._next, *sent))

    def reset(self, state: RobotState) -> None:
        """Start from ``state``, at which the dynamics are; ``upper_body`` is at its posture."""
        pelvis = self._pelvis
        pelvis.reset()
        feet = Feet(ca.DM(state.sole_positions_in_odom), ca.DM(state.sole_rotations_in_odom.reshape(6, 3)))
        led = Led(
            ca.DM(pelvis.rotation),
            ca.DM(pelvis.angular_velocity),
            ca.DM(pelvis.com_displacement),
            ca.DM(self._upper_body.com - self._upper_body.nominal_com),
            ca.DM(self._upper_body.chest),
        )
        chest = self._dynamics.poses[self._motions.poses[ChestOrientation.name]].reshape(3, 3)
        com, rotation = ca.DM(state.com_in_odom), ca.DM(state.pelvis_rotation_in_odom)
        begun = self._reference.begin(feet, led, com, rotation, ca.DM(chest))
        self._memory[:] = np.array(ca.vertcat(_numbers(begun), ca.DM.zeros(3), stance(feet)))[:, 0]
        self.shift = self._memory[_SHIFT].copy()
        self._legs_start[:] = state.joint_position[self._places][self._legs]

    def update(self, state: RobotState, gait: Gait, reference: JointTargets, dt: float) -> None:
        """Compute one period of ``dt`` [s], from the estimate, the gait and the reference of waist and arms."""
        dynamics, pelvis = self._dynamics, self._pelvis
        np.concatenate(
            (
                state.sole_positions_in_odom.ravel(),
                state.sole_rotations_in_odom.ravel(),
                state.com_in_odom,
                state.dcm_in_odom,
                state.pelvis_linear_velocity_in_odom,
                dynamics.task_velocity,
                dynamics.poses,
            ),
            out=self._state,
        )
        np.concatenate((pelvis.rotation.ravel(), pelvis.angular_velocity, pelvis.com_displacement), out=self._led)
        self._legs_led[:] = pelvis.legs
        self._gait[0] = gait.active
        if gait.active:
            self._gait[1:4], self._gait[4:7] = gait.dcm, gait.vrp
        self._gait[7], self._gait[8] = gait.omega, gait.omega_dot
        self._swing[0], self._swing[1] = gait.swinging == 0, gait.swinging == 1
        if gait.swinging is not None:
            point = gait.swing
            np.concatenate(
                (point.position, point.rotation.ravel(), point.velocity, point.acceleration), out=self._swing[2:]
            )
        asked, measured, places = self._asked, self._measured, self._places
        asked[0], asked[1] = reference.position[places], reference.velocity[places]
        asked[2] = reference.acceleration[places]
        measured[0], measured[1] = dynamics.joint_position, dynamics.joint_velocity
        self._dt[0] = dt
        self._evaluate()
        self._memory[:] = self._next
        self.dcm, self.shift, self.centre_dcm, self.centre_vrp = self._sent.copy()

    def _expressions(self, *symbols: Expression) -> Sequence[Expression]:
        state, memory, led, arms_com, chest, legs_led, legs_start, gait, swing, asked, measured, *own, dt = symbols
        position, velocity = own
        soles, rotations, com, dcm, moving, rates, poses = pieces(state, self._sizes)
        feet = Feet(by_rows(soles), by_rows(rotations))
        time, support, shift, offsets, integral, kept = pieces(memory, _MEMORY)
        begun = Begun(time, support, by_rows(shift), by_rows(offsets))
        turn, turning, com_led = pieces(led, (9, 3, 3))
        leading = Led(by_rows(turn), turning, com_led, arms_com - ca.DM(self._upper_body.nominal_com), chest)
        law = replace(self._law, omega=gait[7], omega_dot=gait[8])
        begun, reference = self._reference.advance(begun, feet, leading, (gait[0], gait[1:4], gait[4:7]), dt, law=law)
        nominal = self._law.omega
        own_dcm = at_frequency(dcm, com, nominal / law.omega)
        point, integral = law.repellent_point(own_dcm, reference.dcm, reference.vrp, integral, dt)
        kept = ca.if_else(gait[0], stance(feet), kept)  # stance after the last step
        period = Period(reference, law, com, point, feet, kept, gait[0], swing[:2], swing[2:])
        velocities = rates + ca.sparsify(ca.DM(self._motions.carried)) @ moving
        rows, places = self._motions.rows, self._motions.poses
        wanted = [
            task.acceleration(period, velocities[rows[task.name]], poses[places[task.name]]) for task in self._tasks
        ]

        integrated = ca.DM(self._integrated.astype(float))
        position = ca.if_else(integrated, position, measured[0, :].T)
        velocity = ca.if_else(integrated, velocity, measured[1, :].T)
        lower, upper = self._limits.acceleration(position, velocity)
        nominal_dcm = at_frequency(reference.dcm, com, law.omega / nominal)
        sent = ca.horzcat(nominal_dcm, reference.shift, reference.centre_dcm, reference.centre_vrp).T
        legs = legs_start + reference.legs_blend * (legs_led - legs_start)
        posture = self._posture.acceleration(asked, legs, position, velocity)
        return ca.vertcat(_numbers(begun), integral, kept), sent, ca.vertcat(*wanted), posture, lower, upper, velocity


def _numbers(begun: Begun) -> Expression:
    """(22,) numbers: the fields, row by row."""
    return ca.vertcat(*(ca.vec(field.T) for field in begun))
