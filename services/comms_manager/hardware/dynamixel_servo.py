"""State of one Dynamixel servo: latest measurements, their plausibility, and faults."""

import math

from valor.comms_manager.hardware.condition import Condition, DeviceClock, Limits
from valor.comms_manager.hardware.device import Fault, UnitFault, UnitRecord
from valor.comms_manager.hardware.dynamixel_port import Answer, number_of
from valor.devices.dynamixel import MODELS, DynamixelServo, Item
from valor.robot.description import RobotDescription

LATEST = 0.02  # largest delay of an accepted response [s]
TICKS = 32768  # range of a servo's clock [ms]
COOL = 10  # below its temperature limit, a servo that was too hot is used again [K]
WARM = 10  # below its temperature limit, a servo becomes warm [K]
LOW_VOLTAGE = 0.875  # fraction of the nominal voltage


SPEED, MARGIN = 1.2, 0.05  # bounds of a joint's motion: factor of its velocity limit, and margin [rad]
SMALLEST = 0.24  # smallest jump; a joint that is knocked and braked moves less between responses [rad]
LONGEST_PAUSE = 0.1  # between responses; after a longer one any position is accepted [s]
MISFIT = 0.2  # largest deviation of a motion from the velocities at its ends, as a fraction
# Smallest fraction of a leap's speed in the next response, with which the joint itself moves. A knock may lose half of
# its speed between responses; 0.48 remains of the smallest jump to be detected, 0.25 rad, at 6 rad/s.
GOES_ON = 0.49
DOUBTS_TO_FAULT = 3  # responses after a leap, after which the encoder has jumped


class EncoderWatch:
    """Plausibility of one encoder: a knocked joint moves fast, a joint whose encoder jumps does not move.

    ::

        knock   ___..-'''¯¯¯     responses on the way: velocities fit, or the motion continues, or is braked
        jump    ______|¯¯¯¯¯     none: the joint moves as before
        glitch  ______|_____     returns
    """

    def __init__(self, velocity_limit: float) -> None:
        """``velocity_limit``: of the joint by its own motor [rad/s]."""
        self._limit = SPEED * velocity_limit
        self.position = math.nan  # latest value of the encoder, plausible or not; NaN before the first [rad]
        self.jumped = False  # the encoder has jumped, until it is calibrated
        self._velocity = self._time = 0.0
        self._leap = 0.0  # not yet classified [rad]; 0: none
        self._speed = 0.0  # speed of the leap [rad/s]
        self._doubts = 0  # responses since the leap
        self._knocked = 0.0  # present speed, if above the limit; else 0 [rad/s]

    def reset(self) -> None:
        """Accept any next position, after a gap; ``jumped`` stays."""
        self.position, self._leap, self._knocked = math.nan, 0.0, 0.0

    def is_plausible(self, position: float, velocity: float, time: float) -> bool:
        """Return whether a response is plausible; always true once the encoder has jumped.

        Args:
            position: [rad].
            velocity: reported by the device [rad/s].
            time: of the response, by the device's clock [s].
        """
        moved, elapsed = position - self.position, max(0.0, time - self._time)
        before, mean = self._velocity, 0.5 * (self._velocity + velocity)
        self.position, self._velocity, self._time = position, velocity, time
        if self.jumped or math.isnan(moved):
            return True
        if not 0.0 < elapsed <= LONGEST_PAUSE:
            self._leap = self._knocked = 0.0
            return True
        speed = moved / elapsed
        fast = abs(moved) > max(SMALLEST, self._limit * elapsed + MARGIN)
        if self._leap:
            if abs(moved + self._leap) < 0.5 * abs(self._leap):  # glitch
                self._leap = 0.0
                return True
            if speed / self._speed >= GOES_ON or self._is_braked(moved, before, velocity, elapsed):
                self._leap, self._knocked = 0.0, speed
                return True
            self._doubts += 1
            self.jumped = self._doubts >= DOUBTS_TO_FAULT
            return self.jumped
        fits = abs(moved - mean * elapsed) <= MARGIN + MISFIT * abs(moved)
        if fast and not fits and self._knocked * speed <= 0.0:
            self._leap, self._speed, self._doubts = moved, speed, 1
            return False
        self._knocked = speed if fast else 0.0
        return True

    def _is_braked(self, moved: float, before: float, velocity: float, elapsed: float) -> bool:
        """Return whether a leap was a knock that the servo brakes and reverses within one or two responses.

        Conditions: at the leap the reported velocity exceeded the limit; the motion fits the reported velocities; and
        the present deceleration, extrapolated back, explains the leap.
        """
        side = math.copysign(1.0, self._leap)
        mean = 0.5 * (before + velocity)
        fastest = before + 0.5 * (before - velocity)  # on average, since the response before the leap
        return (
            side * before > self._limit
            and abs(moved - mean * elapsed) <= 0.5 * MARGIN + MISFIT * abs(moved)
            and (1.0 - MISFIT) * abs(self._leap) <= MARGIN + side * fastest * self._leap / self._speed
        )


class Servo:
    """A servo, the measured state of its joint, and its last command."""

    def __init__(self, table: DynamixelServo, device: str, row: int, robot: RobotDescription) -> None:
        self.table = table
        self.model = MODELS[table.model]
        self.registers = self.model.table
        self.spins = table.spin is not None  # it rotates permanently, without set-points
        self.row = row  # of its joint among those of the bus
        self.name = f"{device}/{table.joint}"
        self.record = UnitRecord(table.joint)
        self.position = self.velocity = self.effort = 0.0  # of the joint at ``stamp`` [rad, rad/s, N·m]
        self.stamp = 0  # time of the latest plausible response [ns]; 0 before the first
        self.torque = False  # its motor is on
        self.alert = False  # it reports a hardware error
        self.missed = 0  # consecutive cycles without a response
        self.present = True  # it is read every cycle
        self.unit_faults: tuple[UnitFault, ...] = ()
        self._velocity_limit = float(robot.velocity_limit[robot.index[table.joint]])
        self._encoder = EncoderWatch(self._velocity_limit)
        self._clock = DeviceClock()
        self._tick: int | None = None
        self._ticks = 0  # since the first response [ms]
        self._goal: float | None = None  # latest set-point [rad]
        model = self.model
        hot, low = float(model.temperature_limit), LOW_VOLTAGE * model.voltage
        self._condition = Condition(self.record, Limits(hot - WARM, hot, low, more=0.02 * model.voltage))

    @property
    def jumped(self) -> bool:
        return self._encoder.jumped

    @property
    def is_fit(self) -> bool:
        """True if temperature and voltage allow switching it on again."""
        record, model = self.record, self.model
        return not (record.temperature > model.temperature_limit - COOL or record.voltage < LOW_VOLTAGE * model.voltage)

    def angle(self, steps: int) -> float:
        """Position of the joint [rad] from that of the servo; within ±π if it spins."""
        angle = self.table.direction * (steps - self.table.zero) * self.model.position_unit
        return math.remainder(angle, 2.0 * math.pi) if self.spins else angle

    def reset(self) -> None:
        """Reset clock and encoder checks, after a gap."""
        self._tick = None
        self._clock.reset()
        self._encoder.reset()

    def switched(self, on: bool) -> None:
        """Note that its motor is on, and starts from the joint's position, or off as commanded."""
        self.torque = on
        if on:
            self._goal = None
        else:
            self.unit_faults = ()

    def next_goal(self, target: float, period: float) -> int:
        """Next set-point [steps]: moves to the joint's target [rad] at the velocity limit, every period [s].

        Once its encoder has jumped, the set-point is the encoder's position.
        """
        if self.jumped:
            goal = self._encoder.position
        else:
            last = self.position if self._goal is None else self._goal
            reach = self._velocity_limit * period
            goal = self._goal = min(max(target, last - reach), last + reach)
        steps = self.table.zero + self.table.direction * round(goal / self.model.position_unit)
        lowest, highest = self.model.goals
        return min(max(steps, lowest), highest)

    def process(self, answer: Answer, received: int, must_be_on: bool) -> bool:
        """Process a response received at ``received`` [ns]; returns whether it is plausible."""
        registers, model, direction = self.registers, self.model, self.table.direction
        block, start = answer.data, registers.feedback.address

        def number(item: Item) -> int:
            return number_of(block, item, start)

        if not self._is_timely(number(registers.realtime_tick), 1e-9 * received):
            return False
        position = self.angle(number(registers.present_position))
        velocity = direction * number(registers.present_velocity) * model.velocity_unit
        if not self.spins and not self._encoder.is_plausible(position, velocity, 1e-3 * self._ticks):
            return False
        if self.jumped:
            self.velocity = 0.0
        else:
            self.position, self.velocity = position, velocity
        self.effort = direction * number(registers.present_effort) * model.effort_unit
        self.stamp = received
        temperature, voltage = float(number(registers.present_temperature)), 0.1 * number(registers.present_voltage)
        self._judge(answer, self._condition.judge(temperature, voltage), must_be_on)
        return True

    def _is_timely(self, tick: int, received: float) -> bool:
        """Return whether a response is newer than the last, and not delayed, by the servo's clock."""
        if self._tick is not None:
            step = (tick - self._tick) % TICKS
            if step > TICKS // 2:
                return False
            self._ticks += step
        self._tick = tick
        late = self._clock.lateness(1e-3 * self._ticks, received)
        return late is not None and late < LATEST

    def _judge(self, answer: Answer, condition: tuple[UnitFault, ...], must_be_on: bool) -> None:
        unit, unit_faults = self.record.unit, list(condition)
        if self.jumped:
            unit_faults.append(UnitFault(unit, Fault.ENCODER, "its encoder jumped; to be calibrated, then restarted"))
        if answer.alert and not unit_faults:
            unit_faults.append(UnitFault(unit, Fault.FAULTY, "it reports a hardware error"))
        self.alert = answer.alert
        if must_be_on and not self.torque:
            unit_faults.append(UnitFault(unit, Fault.DISABLED, "its motor is off"))
        self.unit_faults = tuple(unit_faults)
