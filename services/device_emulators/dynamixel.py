"""Dynamixel servos in the simulated robot, at the far end of their serial port."""

from __future__ import annotations

import math

import numpy as np

from valor.common.instance import Instance, Settings
from valor.common.messages import JointMode
from valor.device_emulators.dynamixel_bus import DynamixelBus
from valor.device_emulators.dynamixel_servo import Servo
from valor.device_emulators.emulator import EmulatedFault, Emulator, FaultSwitches
from valor.device_emulators.robot import SimulatedRobot
from valor.device_emulators.serial_port import SerialPort, line
from valor.devices.dynamixel import MODELS, Dynamixel, DynamixelServo, OperatingMode
from valor.devices.ports import serial_port
from valor.robot.description import RobotDescription

ADAPTER = "port"  # the unit that all servos are behind: unplugged, the port is gone
JUMP = 0.5  # of an encoder [rad]
FEVER = 90.0  # [°C]
WEAK_SUPPLY = 40.0 / 48.0  # of the nominal voltage
ROOM, FULL_TORQUE_HEATING, THERMAL_TIME = 32.0, 30.0, 60.0  # [°C], [K], [s]
FEELING = 0.02  # between looks at the joints, when nobody asks [s]


class _JointServo:
    """A servo and its joint."""

    def __init__(self, table: DynamixelServo, robot: RobotDescription) -> None:
        self.table = table
        self.name = table.joint
        self.model = MODELS[table.model]
        self.servo = Servo(table.id, self.model, table.firmware)
        self.joint = np.array([robot.index[table.joint]], dtype=np.intp)
        self.effort_limit = float(robot.effort_limit[self.joint[0]])
        self.dead = False  # without power
        self.turned = 0.0  # where one that spins is to be now, from its zero [rad]
        self.jump = 0.0  # by which its encoder is off [rad]
        self.temperature = ROOM
        self.time: float | None = None  # when it felt its joint last [s of the robot]
        self.state: tuple[object, ...] = ()  # that its motor was told last


class DynamixelEmulator(Emulator):
    """All servos of a device; units are called after their joints, and ``port`` is the adapter that they share."""

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, Dynamixel)
        self._servos = [_JointServo(each, robot) for each in table.servos]
        super().__init__(name, FaultSwitches((*(servo.name for servo in self._servos), ADAPTER)))
        self._port = SerialPort(serial_port(instance, settings, name))
        self._line = line(self._port, self.faults)
        self._bus = DynamixelBus([each.servo for each in self._servos])
        self._felt = -math.inf

    def files(self) -> tuple[int, ...]:
        """The port."""
        return (self._port.fileno(),)

    def close(self) -> None:
        """Give the port back."""
        self._port.close()

    def step(self, now: float, robot: SimulatedRobot) -> None:
        """Let the servos feel their joints, obey and answer."""
        if self.faults.active(ADAPTER, EmulatedFault.UNPLUGGED, now):
            self._port.unplug()
        else:
            self._port.plug()
        received = self._port.read()
        if received or now - self._felt >= FEELING:
            self._felt = now
            for each in self._servos:
                self._power(each, now, robot)
                self._feel(each, now, robot)
            self._bus.servos = {each.table.id: each.servo for each in self._servos if not each.dead}
            names = {each.table.id: each.name for each in self._servos}
            for status in self._bus.receive(received):
                unit = ADAPTER if self._faulty(ADAPTER, now) else names[status.servo]
                self._line.send(unit, status.frame, now)
            for each in self._servos:
                self._drive(each, robot)
        self._line.flush(now)

    def _faulty(self, unit: str, now: float) -> bool:
        return any(self.faults.active(unit, fault, now) for fault in EmulatedFault)

    def _has(self, each: _JointServo, fault: EmulatedFault, now: float) -> bool:
        return self.faults.active(each.name, fault, now) or self.faults.active(ADAPTER, fault, now)

    def _power(self, each: _JointServo, now: float, robot: SimulatedRobot) -> None:
        """Take the supply away from a servo, or give it back."""
        dead = self.faults.active(each.name, EmulatedFault.UNPLUGGED, now)
        if dead != each.dead:
            each.dead = dead
            each.servo = Servo(each.table.id, each.model, each.table.firmware)

    def _feel(self, each: _JointServo, now: float, robot: SimulatedRobot) -> None:
        """What encoder, current sensor, thermometer and voltmeter say."""
        measured, place, servo = robot.measured, each.joint, each.servo
        # A slow computer is a slow robot: what turns and warms does so in the robot's time, not the wall's.
        elapsed = 0.0 if each.time is None else robot.time - each.time
        each.time = robot.time
        position, velocity, effort = (
            each.table.direction * float(values[place][0])
            for values in (measured.joint_position, measured.joint_velocity, measured.joint_effort)
        )
        if servo.torque and servo.mode == OperatingMode.VELOCITY:
            each.turned += servo.goal_velocity * elapsed
        share = effort / each.effort_limit
        settled = ROOM + FULL_TORQUE_HEATING * share * share
        each.temperature += (settled - each.temperature) * min(1.0, elapsed / THERMAL_TIME)
        servo.temperature = FEVER if self._has(each, EmulatedFault.OVER_TEMPERATURE, now) else each.temperature
        weak = self._has(each, EmulatedFault.UNDER_VOLTAGE, now)
        servo.voltage = each.model.voltage * (WEAK_SUPPLY if weak else 1.0)
        each.jump = JUMP if self._has(each, EmulatedFault.ENCODER_JUMP, now) else 0.0
        servo.feel(each.table.zero + (position + each.jump) / each.model.position_unit, velocity, effort, now)

    def _drive(self, each: _JointServo, robot: SimulatedRobot) -> None:
        """Have the joint's motor do as the control table says."""
        servo, direction = each.servo, each.table.direction
        state = (servo.torque, servo.mode, servo.goal_position, each.turned, each.jump)
        if state == each.state:
            return
        if not each.state or servo.torque != each.state[0]:
            robot.power(each.joint, servo.torque)
            each.turned = float(robot.measured.joint_position[each.joint][0]) * direction
        each.state = (*state[:3], each.turned, each.jump)
        if not servo.torque:
            return
        if servo.mode == OperatingMode.VELOCITY:
            goal, velocity = each.turned, servo.goal_velocity
        else:
            goal = (servo.goal_position - each.table.zero) * each.model.position_unit - each.jump
            velocity = 0.0
        robot.command(
            each.joint,
            mode=JointMode.POSITION,
            position=direction * goal,
            velocity=direction * velocity,
            effort=0.0,
            stiffness=0.0,
            damping=0.0,
        )
