"""What a servo that goes by position leaves undone: weight, friction and play, made up for by where it is told to go.

A joint driven by impedance turns its motor by

    u = share·τ + k_p·play(p − q) + k_d·(ṗ − q̇),

in which a device that goes by position and velocity alone takes no effort (share 0), and a worn gear has play ± b,
within which no stiffness acts. So the controller's set-point p is not where the joint comes to rest. Here

    p = p_wanted + (1 − share)·(τ/k_p + b·sat(τ/τ₀)) + (friction·sat(ṗ/v₀) + damping·ṗ + offset + load)/k_p + i,

in which share, b and friction are found while the robot moves, of what the motors say they turn with and of the model's
torques τ, and i integrates what is still missing within the bounds of the greatest play and a part of the joint's
torque. What is within ``FINE`` of its goal is left alone: a joint that sticks there would only be set to hunt.

Of a joint that was calibrated (``valor.robot.arm_calibration``) damping, offset and the strength of its servo, which
k_p and k_d are multiplied by, are known, and the others begin with what was found then.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, clipped
from valor.motion_manager.joints.drives import Drives
from valor.robot.description import RobotDescription
from valor.robot.model import Indices
from valor.whole_body.motor_command import MotorCommand
from valor.whole_body.state import RobotState, WholeBodyCommand
from valor.whole_body.tuning_tables import Tuning

PERIOD = 0.0079  # at which the offset is found anew: more often than arms are told where to go [s]
FINE = 0.001  # error that is left alone [rad]
INTEGRAL_RATE = 4.0  # [1/s]
SMOOTHING = 0.05  # of what is compared [s]
LEARNING = 0.3  # of share, play and friction [s]; of what was calibrated as ``Drives`` has it
LOADED = 2.0  # torque of a motor that turns its gear to one side of the play [N·m]
TURNED = 1.0  # τ₀, from which the gear is taken to be turned to one side [N·m]
MOVING = 0.05  # v₀, from which friction is taken to act against the motion [rad/s]
_MEMORY = 7  # share, play, friction, integral; smoothed: motor's torque, torque by the set-point, model's torque


class ServoCompensation:
    """Of the arms' joints that are driven by impedance, m of them.

    Attributes:
        joints: (m,) their places in every joint vector.
        integral: (m,) i [rad]. share, play, friction: (m,) as found [–, rad, N·m].
        offset: (m,) p − p_wanted of the last period [rad].
        load: (m,) effort that holds what the hands carry [N·m]; written by who knows.
        pressing: (m,) 1 where the hand presses on something, and i stays; likewise.
    """

    def __init__(self, robot: RobotDescription, motors: MotorCommand) -> None:
        arms = [robot.group_indices(group) for group in ("left_arm", "right_arm") if robot.tables.group(group)]
        places = np.sort(np.concatenate(arms)) if arms else np.zeros(0, dtype=np.intp)
        compensated = motors.impedance[places] & robot.read(Tuning).arm_servos.compensation
        self.joints = places[compensated]
        first, m = (int(self.joints[0]), len(self.joints)) if self.joints.size else (0, 0)
        contiguous = np.array_equal(self.joints, np.arange(first, first + m))
        self._places: Indices = slice(first, first + m) if contiguous else self.joints
        self._motors = motors
        self._stiffness = robot.servo_stiffness[self.joints]
        members = np.array([np.isin(self.joints, arm) for arm in arms], dtype=np.float64).reshape(len(arms), m)
        self._same = members.T @ members  # which are of one arm
        self._drives = Drives(robot, self.joints)
        self._memory, self._next = np.zeros((_MEMORY, m)), np.zeros((_MEMORY, m))
        self._memory[:3] = self._drives.share, self._drives.play, self._drives.friction
        self._seen = np.zeros((11, m))
        self._flat = self._seen.reshape(-1)
        self._hands = np.zeros((2, m))
        self.load, self.pressing = self._hands
        self.offset, self._told = np.zeros(m), np.zeros(len(robot.joints))
        self._dt = np.zeros(2)
        self._since = 0.0  # the offset was found [s]
        if m:
            self._evaluate = Kernel(
                "servos",
                self._expressions,
                (self._memory, self._seen, self._hands, self._dt),
                (self._next, self.offset),
            )
        self.share, self.play, self.friction, self.integral = self._memory[:4]

    def reset(self) -> None:
        """Balance begins: what was missing then may be no more; what was found of the gears is kept."""
        self.integral[:] = 0.0

    def offsets(self, state: RobotState, command: WholeBodyCommand, dt: float, *, whole: bool) -> FloatArray:
        """By how much a command's set-points are to be moved; before it is sent.

        Args:
            state: the estimate.
            command: of the Whole-Body Controller.
            dt: since the last period [s].
            whole: whether the Whole-Body Controller alone had the joints in the last period.

        Returns:
            (n,) p − p_wanted, 0 of joints that are not compensated [rad]; valid until the next period.
        """
        if not self.joints.size:
            return self._told
        self._since += dt
        if self._since >= PERIOD:
            self._find(state, command, whole=whole)
            self._told[self._places] = self.offset
        return self._told

    def _find(self, state: RobotState, command: WholeBodyCommand, *, whole: bool) -> None:
        """The offset of the periods to come."""
        motors = self._motors
        drive = motors.drive
        np.concatenate(
            [
                values[self._places]
                for values in (
                    state.joint_position, state.joint_velocity, state.joint_effort, motors.position, motors.velocity,
                    motors.effort, drive.stiffness, drive.damping, command.position, command.velocity, command.effort,
                )
            ],
            out=self._flat,
        )  # fmt: skip
        self._dt[0], self._dt[1] = min(self._since, 2.0 * PERIOD), whole
        self._since = 0.0
        self._evaluate()
        self._memory[:] = self._next

    def _expressions(
        self, memory: Expression, seen: Expression, hands: Expression, dt: Expression
    ) -> Sequence[Expression]:
        load, pressing = hands[0, :].T, hands[1, :].T
        share, play, friction, integral, torque, by_place, model = (memory[i, :].T for i in range(_MEMORY))
        q, rate, motor, p, p_rate, effort, k_p, k_d, wanted, wanted_rate, needed = (seen[i, :].T for i in range(11))
        dt, whole = dt[0], dt[1]
        nominal = ca.DM(self._stiffness)
        strength, damping, pull, relearning, most_play, most_friction = (ca.DM(each) for each in self._drives.constants)
        stiff = k_p > 0.99 * nominal
        k_p = strength * ca.fmax(k_p, 1e-3 * nominal)
        k_d *= strength
        soft = dt / SMOOTHING
        torque += soft * (motor - torque)
        by_place += soft * (k_p * (p - q) + k_d * (p_rate - rate) - by_place)
        model += soft * (effort - model)
        learning = whole * dt / LEARNING

        same = ca.DM(self._same)
        squares = same @ (model * model)
        found = clipped(same @ ((torque - by_place) * model) / (squares + 1.0), 0.0, 1.0)
        told = (squares > 4.0 * LOADED**2) * (same @ (torque * torque) > LOADED**2)
        share += learning * told * (found - share)
        taken = clipped(2.0 * share - 0.5, 0.0, 1.0)

        gap = clipped(ca.sign(torque) * (by_place - torque) / k_p, 0.0, most_play)
        play += learning * relearning * (ca.fabs(torque) > LOADED) * (1.0 - taken) * (gap - play)

        drag = ca.sign(rate) * (torque - model - load - pull) - damping * ca.fabs(rate)
        moves = (ca.fabs(rate) > MOVING) * (ca.fabs(wanted_rate) > MOVING) * (rate * wanted_rate > 0.0)
        friction += learning * relearning * moves * (clipped(drag, 0.0, most_friction) - friction)

        error = wanted - q
        most = most_play + most_friction / (strength * nominal)
        on = whole * (ca.fabs(error) > FINE) * stiff * (1.0 - pressing)
        integral = clipped(integral + dt * INTEGRAL_RATE * on * error, -most, most)

        against = friction * clipped(wanted_rate / MOVING, -1.0, 1.0) + damping * wanted_rate + pull + load
        turning = (1.0 - taken) * needed + against
        offset = turning / k_p + (1.0 - taken) * play * clipped(turning / TURNED, -1.0, 1.0) + integral
        kept = ca.horzcat(share, play, friction, integral, torque, by_place, model).T
        return kept, offset
