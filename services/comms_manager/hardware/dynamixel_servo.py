"""One Dynamixel servo as its driver knows it: what it said last, whether that can be believed, and what ails it."""

from __future__ import annotations

import math

from valor.comms_manager.hardware.condition import Condition, Limits
from valor.comms_manager.hardware.device import Ailment, Fault, UnitRecord
from valor.comms_manager.hardware.device_clock import DeviceClock
from valor.comms_manager.hardware.dynamixel_port import Answer, number_of
from valor.comms_manager.hardware.encoder_watch import EncoderWatch
from valor.devices.dynamixel import MODELS, ControlTable, DynamixelServo, Item
from valor.robot.description import RobotDescription

LATEST = 0.02  # an answer that was held up longer is not used [s]
TICKS = 32768  # of a servo's clock, in milliseconds, until it begins anew
COOL = 10  # below its limit, at which a servo that was too hot is used again [K]
WARM = 10  # below its limit, from which on a servo is warm [K]
LOW_VOLTAGE = 0.875  # of the nominal one


class Servo:
    """A servo, its joint's measured state, and what was commanded last.

    Attributes:
        row: of its joint among those of the bus.
        position: of the joint, as of ``stamp`` [rad].
        velocity: [rad/s].
        effort: [N·m].
        stamp: when the last answer came that is believed [ns]; 0: none has.
        torque: it is switched on.
        alert: it says that something is wrong with it.
        missed: cycles in a row without an answer.
        present: it is read in every cycle.
    """

    def __init__(self, table: DynamixelServo, device: str, row: int, robot: RobotDescription) -> None:
        self.table = table
        self.model = MODELS[table.model]
        self.row = row
        self.name = f"{device}/{table.joint}"
        self.record = UnitRecord(table.joint)
        self.position = self.velocity = self.effort = 0.0
        self.stamp = 0
        self.torque = False
        self.alert = False
        self.missed = 0
        self.present = True
        self.ailments: tuple[Ailment, ...] = ()
        self._velocity_limit = float(robot.velocity_limit[robot.index[table.joint]])
        self._encoder = EncoderWatch(self._velocity_limit)
        self._clock = DeviceClock()
        self._tick: int | None = None
        self._ticks = 0  # since the first answer [ms]
        self._goal: float | None = None  # sent last [rad]
        model = self.model
        hot, low = float(model.temperature_limit), LOW_VOLTAGE * model.voltage
        self._condition = Condition(self.record, Limits(hot - WARM, hot, low, more=0.02 * model.voltage))

    @property
    def registers(self) -> ControlTable:
        """Where its numbers stand."""
        return self.model.table

    @property
    def spins(self) -> bool:
        """Whether it turns for ever, and obeys no set-point."""
        return self.table.spin is not None

    @property
    def jumped(self) -> bool:
        """Whether its encoder did, and is believed no more."""
        return self._encoder.jumped

    @property
    def is_fit(self) -> bool:
        """Whether it is cool enough and has voltage enough to be switched on again."""
        record, model = self.record, self.model
        return not (record.temperature > model.temperature_limit - COOL or record.voltage < LOW_VOLTAGE * model.voltage)

    def angle(self, steps: int) -> float:
        """The joint's position for the servo's [rad]; that of one that spins stays within a turn."""
        angle = self.table.direction * (steps - self.table.zero) * self.model.position_unit
        return math.remainder(angle, 2.0 * math.pi) if self.spins else angle

    def forget(self) -> None:
        """Its clock may have begun anew, and its joint may have been moved."""
        self._tick = None
        self._clock.reset()
        self._encoder.forget()

    # --- what it is told ----------------------------------------------------------------------------------------------

    def switched_on(self) -> None:
        """Its motor is on: it holds its joint where that is, and goes on from there."""
        self.torque = True
        self._goal = None

    def switched_off(self) -> None:
        """Its motor is off, and shall be."""
        self.torque = False
        self.ailments = ()

    def next_goal(self, wanted: float, period: float) -> int:
        """The servo's set-point [steps]: the joint's [rad], approached at its velocity limit, period by period [s].

        Once its encoder has jumped, it stays where it says that it is.
        """
        if self.jumped:
            goal = self._encoder.position
        else:
            last = self.position if self._goal is None else self._goal
            reach = self._velocity_limit * period
            goal = self._goal = min(max(wanted, last - reach), last + reach)
        steps = self.table.zero + self.table.direction * round(goal / self.model.position_unit)
        lowest, highest = self.model.goals
        return min(max(steps, lowest), highest)

    # --- what it says -------------------------------------------------------------------------------------------------

    def take(self, answer: Answer, came: int, shall_be_on: bool) -> bool:
        """Take in an answer that came at a time [ns]; returns whether it can be believed."""
        registers, model, direction = self.registers, self.model, self.table.direction
        block, start = answer.data, registers.feedback.address

        def number(item: Item) -> int:
            return number_of(block, item, start)

        if not self._is_timely(number(registers.realtime_tick), 1e-9 * came):
            return False
        position = self.angle(number(registers.present_position))
        velocity = direction * number(registers.present_velocity) * model.velocity_unit
        if not self.spins and not self._encoder.believes(position, velocity, 1e-3 * self._ticks):
            return False
        if self.jumped:
            self.velocity = 0.0
        else:
            self.position, self.velocity = position, velocity
        self.effort = direction * number(registers.present_current) * model.current_unit * model.torque_constant
        self.stamp = came
        temperature, voltage = float(number(registers.present_temperature)), 0.1 * number(registers.present_voltage)
        self._judge(answer, self._condition.judge(temperature, voltage), shall_be_on)
        return True

    def _is_timely(self, tick: int, came: float) -> bool:
        """Whether an answer is newer than the last, and not held up; servos number nothing, but tell their time."""
        if self._tick is not None:
            step = (tick - self._tick) % TICKS
            if step > TICKS // 2:
                return False
            self._ticks += step
        self._tick = tick
        late = self._clock.lateness(1e-3 * self._ticks, came)
        return late is not None and late < LATEST

    def _judge(self, answer: Answer, condition: tuple[Ailment, ...], shall_be_on: bool) -> None:
        """Write down what ails it, besides its condition."""
        unit, ailments = self.record.unit, list(condition)
        if self.jumped:
            ailments.append(Ailment(unit, Fault.ENCODER, "its encoder jumped; to be calibrated, then restarted"))
        if answer.alert and not ailments:
            ailments.append(Ailment(unit, Fault.FAULTY, "it reports a hardware error"))
        self.alert = answer.alert
        if shall_be_on and not self.torque:
            ailments.append(Ailment(unit, Fault.DISABLED, "its motor is off"))
        self.ailments = tuple(ailments)
