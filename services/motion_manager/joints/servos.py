"""Gains of the joints driven by impedance, and compensation of the arms' servos for weight, friction and play.

A joint driven by impedance applies the motor torque

    u = share·τ + k_p·play(p − q) + k_d·(ṗ − q̇).

A device with position and velocity inputs only ignores the effort (share 0). A worn gear has play ± b, within which no
stiffness acts. So the joint does not come to rest at the controller's set-point p. Therefore

    p = p_wanted + (1 − share)·(τ/k_p + b·sat(τ/τ₀)) + (friction·sat(ṗ/v₀) + damping·ṗ + offset + load)/k_p + i.

Share, b and friction are estimated while the robot moves, from the reported motor torques and the torques τ of the
model. The integral i covers the rest, bounded by the largest play and a fraction of the joint's torque. Errors below
``FINE`` are not integrated, because a sticking joint would hunt. A calibrated joint (``valor.robot.arm_calibration``)
starts from its calibrated values, which also give damping, offset and strength of its servo, a factor on k_p and k_d.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel, clipped
from valor.control.controller import JointCommand
from valor.control.motor_command import MotorCommand
from valor.control.state import RobotState
from valor.control.tuning_tables import Tuning
from valor.robot import arm_calibration
from valor.robot.arm_calibration import JointCalibration
from valor.robot.description import RobotDescription
from valor.robot.limiter import Joints
from valor.robot.model import Indices

CHANGE_TIME = 0.5  # time for a change by the nominal value [s]
PERIOD = 0.0079  # period of updates, shorter than that of the arms' set-points [s]
FINE = 0.001  # error that is not integrated [rad]
INTEGRAL_RATE = 4.0  # [1/s]
SMOOTHING = 0.05  # time constant of the compared torques [s]
LEARNING = 0.3  # time constant of share, play and friction [s]; slower for calibrated joints
LOADED = 2.0  # torque of a motor that moves its gear to one side of the play [N·m]
TURNED = 1.0  # τ₀, torque from which the gear is at one side [N·m]
MOVING = 0.05  # v₀, speed from which friction acts against the motion [rad/s]
MOST_PLAY = 0.05  # largest play to either side [rad]
FRICTION_SHARE = 0.1  # largest friction, fraction of a joint's effort limit
ROOM = 1.5  # largest play and friction of a calibrated joint, multiples of the calibrated values
RELEARNING = 0.03  # rate of learning play and friction of a calibrated joint, fraction of ``1 / LEARNING``
WEAKEST = 0.5  # least strength that is compensated
_GOOD = JointCalibration(
    friction=0.0, damping=0.0, offset=0.0, backlash=0.0, effort_share=1.0, strength=1.0, residual=0.0
)
_MEMORY = 7  # share, play, friction, integral; smoothed: motor torque, torque by the set-point, model torque


class JointGains:
    """Gains that change gradually to the requested ones, so that torques do not jump.

    Attributes:
        stiffness, damping: (n,) active [N·m/rad, N·m·s/rad].
        lower_stiffness, upper_stiffness, lower_damping, upper_damping: (n,) limits.
    """

    def __init__(self, robot: RobotDescription, impedance: Joints) -> None:
        self.impedance = impedance  # (n,) mask of adjustable joints
        self._nominal = (robot.servo_stiffness, robot.servo_damping)
        table = robot.read(Tuning).gains
        self.lower_stiffness, self.upper_stiffness = (
            factor * robot.servo_stiffness for factor in (table.min_stiffness, table.max_stiffness)
        )
        self.lower_damping, self.upper_damping = (
            factor * robot.servo_damping for factor in (table.min_damping, table.max_damping)
        )
        fraction = robot.control_period / CHANGE_TIME
        self._steps = (fraction * robot.servo_stiffness, fraction * robot.servo_damping)
        self.reset()

    def reset(self) -> None:
        """Restore the nominal gains at once, at the start of balance."""
        self.stiffness, self.damping = self._requested = self._nominal

    def request(self, joints: npt.NDArray[np.intp], stiffness: FloatArray, damping: FloatArray) -> None:
        """Request (k,) gains within the limits [N·m/rad, N·m·s/rad] for the (k,) indices ``joints``."""
        stiffness_goal, damping_goal = (gains.copy() for gains in self._requested)
        stiffness_goal[joints], damping_goal[joints] = stiffness, damping
        self._requested = (stiffness_goal, damping_goal)

    def advance(self) -> None:
        """Advance one control period; the arrays are new ones when the gains change."""
        present = (self.stiffness, self.damping)
        if present[0] is self._requested[0] and present[1] is self._requested[1]:
            return  # nearly always
        if all(now is asked or np.array_equal(now, asked) for now, asked in zip(present, self._requested, strict=True)):
            return
        self.stiffness, self.damping = (
            np.clip(asked, now - step, now + step)
            for asked, now, step in zip(self._requested, present, self._steps, strict=True)
        )


class Drives:
    """Parameters of m joints, calibrated (``valor.robot.arm_calibration``) or ideal; (m,) each.

    Attributes:
        share: fraction of Motor's effort that the device applies. play: to either side [rad]. friction: Coulomb [N·m].
        constants: strength of the servo; damping [N·m·s/rad]; offset [N·m]; relative rate of learning play and
            friction; their largest values.
    """

    def __init__(self, robot: RobotDescription, joints: npt.NDArray[np.intp]) -> None:
        """Raises ``ConfigurationError`` if the calibration does not fit; ``joints`` (m,) index every joint vector."""
        table = arm_calibration.load(robot) if joints.size else None
        found = table.joints() if table else {}
        names = [robot.joints[index] for index in joints]
        drives = [found.get(name, _GOOD) for name in names]
        self.share = np.array([drive.effort_share for drive in drives])
        self.play = np.array([0.5 * (drive.backlash or 0.0) for drive in drives])
        self.friction = np.array([drive.friction for drive in drives])
        self.constants: tuple[FloatArray, ...] = (
            np.array([max(drive.strength, WEAKEST) for drive in drives]),
            np.array([drive.damping for drive in drives]),
            np.array([drive.offset for drive in drives]),
            np.array([RELEARNING if name in found else 1.0 for name in names]),
            np.maximum(MOST_PLAY, ROOM * self.play),
            np.maximum(FRICTION_SHARE * robot.effort_limit[joints], ROOM * self.friction),
        )


class ServoCompensation:
    """Compensation of the m joints of the arms that are driven by impedance.

    Attributes:
        integral: (m,) i [rad]. share, play, friction: (m,) estimates [–, rad, N·m].
        offset: (m,) p − p_wanted [rad], approached so that p moves within the joints' velocity limits.
        load: (m,) effort that compensates the hands' loads [N·m]; written by ``HandLoads``.
        pressing: (m,) 1 if the hand presses on something: i is constant; written by ``HandLoads``.
    """

    def __init__(self, robot: RobotDescription, motors: MotorCommand) -> None:
        arms = robot.arms()
        indices = np.sort(np.concatenate(arms)) if arms else np.zeros(0, dtype=np.intp)
        wanted = robot.read(Tuning).arm_servos.compensation and robot.tables.arm_control == "compensated"
        compensated = motors.impedance[indices] & wanted
        self.joints = indices[compensated]  # (m,) their indices in every joint vector
        first, m = (int(self.joints[0]), len(self.joints)) if self.joints.size else (0, 0)
        contiguous = np.array_equal(self.joints, np.arange(first, first + m))
        self._indices: Indices = slice(first, first + m) if contiguous else self.joints
        self._motors = motors
        self._stiffness = robot.servo_stiffness[self.joints]
        self._fastest = robot.velocity_limit[self.joints]
        members = np.array([np.isin(self.joints, arm) for arm in arms], dtype=np.float64).reshape(len(arms), m)
        self._same = members.T @ members  # 1 for pairs of one arm
        self._drives = Drives(robot, self.joints)
        self._memory, self._next = np.zeros((_MEMORY, m)), np.zeros((_MEMORY, m))
        self._memory[:3] = self._drives.share, self._drives.play, self._drives.friction
        self._inputs = np.zeros((11, m))
        self._flat = self._inputs.reshape(-1)
        self._hands = np.zeros((2, m))
        self.load, self.pressing = self._hands
        self.offset, self._offsets = np.zeros(m), np.zeros(len(robot.joints))
        self._dt = np.zeros(2)
        self._since = 0.0  # time since the last update [s]
        if m:
            self._evaluate = Kernel(
                "servos",
                self._expressions,
                (self._memory, self._inputs, self._hands, self._dt),
                (self._next, self.offset),
            )
        self.share, self.play, self.friction, self.integral = self._memory[:4]

    def reset(self) -> None:
        """Clear the integral, at the start of balance; the estimates of the gears are kept."""
        self.integral[:] = 0.0

    def offsets(self, state: RobotState, command: JointCommand, dt: float, *, complete: bool) -> FloatArray:
        """(n,) p − p_wanted of set-points [rad]; ``complete``: full control by the QP in the last ``dt`` [s]."""
        if not self.joints.size:
            return self._offsets
        self._since += dt
        if self._since >= PERIOD:
            self._update(state, command, complete=complete)
        present = self._offsets[self._indices]
        step = np.maximum(self._fastest - np.abs(command.velocity[self._indices]), 0.0) * dt
        self._offsets[self._indices] = np.minimum(np.maximum(self.offset, present - step), present + step)
        return self._offsets

    def _update(self, state: RobotState, command: JointCommand, *, complete: bool) -> None:
        motors = self._motors
        drive = motors.drive
        np.concatenate(
            [
                values[self._indices]
                for values in (
                    state.joint_position, state.joint_velocity, state.joint_effort, motors.position, motors.velocity,
                    motors.effort, drive.stiffness, drive.damping, command.position, command.velocity, command.effort,
                )
            ],
            out=self._flat,
        )  # fmt: skip
        self._dt[0], self._dt[1] = min(self._since, 2.0 * PERIOD), complete
        self._since = 0.0
        self._evaluate()
        self._memory[:] = self._next

    def _expressions(
        self, memory: Expression, inputs: Expression, hands: Expression, dt: Expression
    ) -> Sequence[Expression]:
        load, pressing = hands[0, :].T, hands[1, :].T
        share, play, friction, integral, torque, by_position, model = (memory[i, :].T for i in range(_MEMORY))
        q, rate, motor, p, p_rate, effort, k_p, k_d, wanted, wanted_rate, needed = (inputs[i, :].T for i in range(11))
        dt, complete = dt[0], dt[1]
        nominal = ca.DM(self._stiffness)
        strength, damping, pull, relearning, most_play, most_friction = (ca.DM(each) for each in self._drives.constants)
        stiff = k_p > 0.99 * nominal
        k_p = strength * ca.fmax(k_p, 1e-3 * nominal)
        k_d *= strength
        soft = dt / SMOOTHING
        torque += soft * (motor - torque)
        by_position += soft * (k_p * (p - q) + k_d * (p_rate - rate) - by_position)
        model += soft * (effort - model)
        learning = complete * dt / LEARNING

        same = ca.DM(self._same)
        squares = same @ (model * model)
        estimate = clipped(same @ ((torque - by_position) * model) / (squares + 1.0), 0.0, 1.0)
        loaded = (squares > 4.0 * LOADED**2) * (same @ (torque * torque) > LOADED**2)
        share += learning * loaded * (estimate - share)
        taken = clipped(2.0 * share - 0.5, 0.0, 1.0)

        gap = clipped(ca.sign(torque) * (by_position - torque) / k_p, 0.0, most_play)
        play += learning * relearning * (ca.fabs(torque) > LOADED) * (1.0 - taken) * (gap - play)

        drag = ca.sign(rate) * (torque - model - load - pull) - damping * ca.fabs(rate)
        moves = (ca.fabs(rate) > MOVING) * (ca.fabs(wanted_rate) > MOVING) * (rate * wanted_rate > 0.0)
        friction += learning * relearning * moves * (clipped(drag, 0.0, most_friction) - friction)

        error = wanted - q
        most = most_play + most_friction / (strength * nominal)
        on = complete * (ca.fabs(error) > FINE) * stiff * (1.0 - pressing)
        integral = clipped(integral + dt * INTEGRAL_RATE * on * error, -most, most)

        against = friction * clipped(wanted_rate / MOVING, -1.0, 1.0) + damping * wanted_rate + pull + load
        turning = (1.0 - taken) * needed + against
        offset = turning / k_p + (1.0 - taken) * play * clipped(turning / TURNED, -1.0, 1.0) + integral
        kept = ca.horzcat(share, play, friction, integral, torque, by_position, model).T
        return kept, offset
