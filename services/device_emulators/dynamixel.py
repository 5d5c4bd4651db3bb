"""Emulated Dynamixel servos: protocol 2.0, control tables and firmware behavior.

From the public e-manual, page "Protocol 2.0": frames, stuffing, CRC-16, instructions, errors, write rules and shutdown.
Assumption: servos behind a servo that does not respond still respond to a sync read::

    0xFF 0xFF 0xFD 0x00 │ id │ length │ instruction │ [error] parameters … │ CRC
            4           │ 1  │ 2, LE  │      1      │                      │ 2, LE

``length`` counts from the instruction to the CRC. After 0xFF 0xFF 0xFD in instruction and parameters, 0xFD is stuffed.
"""

import math
from collections.abc import Container, Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from dynamixel_sdk import Protocol2PacketHandler

from valor.common.instance import Instance, Settings
from valor.common.messages import JointMode
from valor.device_emulators.emulator import ALL_FAULTS, EmulatedFault, Emulator, FaultyLine
from valor.device_emulators.robot import SimulatedRobot
from valor.device_emulators.serial_port import SerialPort
from valor.devices.dynamixel import (
    DEFAULT_SHUTDOWN,
    MODELS,
    Dynamixel,
    DynamixelServo,
    HardwareError,
    Item,
    OperatingMode,
    ServoModel,
)
from valor.devices.frame_stream import FrameStream
from valor.devices.ports import serial_port
from valor.robot.description import RobotDescription

HEADER = b"\xff\xff\xfd\x00"
PREFIX = 7  # bytes up to and including the length [B]
BROADCAST = 0xFE
MAX_LENGTH = 1024


class Instruction(IntEnum):
    """Instruction of a frame."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class Error(IntEnum):
    """Error of a status frame; bit 7 (ALERT) is set while ``hardware_error`` is not 0."""

    NONE = 0
    INSTRUCTION = 2
    DATA_RANGE = 4
    DATA_LENGTH = 5
    ACCESS = 7
    ALERT = 0x80


class Status(NamedTuple):
    """Response frame of a servo."""

    servo: int
    frame: bytes


class Servo:
    """One servo: control table, written by the driver; present values, written by ``measure``."""

    def __init__(self, servo_id: int, model: ServoModel, firmware: int) -> None:
        self.id = servo_id
        self.model = model
        table = model.table
        self._registers = bytearray(table.size)
        self.set(table.model_number, model.number)
        self.set(table.firmware, firmware)
        self.set(table.operating_mode, OperatingMode.POSITION)
        self.temperature = 32.0  # of the motor [°C]
        self.voltage = model.voltage  # of the supply [V]

    def get(self, item: Item) -> int:
        return int.from_bytes(self._registers[item.address : item.address + item.size], "little", signed=item.signed)

    def set(self, item: Item, value: int) -> None:
        """Write an item as the firmware does, also where the driver has no write access."""
        data = (value & ((1 << 8 * item.size) - 1)).to_bytes(item.size, "little")
        self._registers[item.address : item.address + item.size] = data

    def read(self, address: int, size: int) -> bytes | None:
        """Bytes of the table; None if the range is outside it."""
        if size < 1 or address + size > len(self._registers):
            return None
        return bytes(self._registers[address : address + size])

    def write(self, address: int, data: bytes) -> Error:
        """Execute a write of the driver."""
        table = self.model.table
        writable = (table.torque_enable, table.goal_velocity, table.goal_position, table.operating_mode)
        item = next((each for each in writable if (each.address, each.size) == (address, len(data))), None)
        if item is None or (item == table.operating_mode and self.torque):
            return Error.ACCESS
        value = int.from_bytes(data, "little", signed=item.signed)
        if value not in self._allowed(item):
            return Error.DATA_RANGE
        if item == table.torque_enable and value and not self.torque:
            if self.get(table.hardware_error) & DEFAULT_SHUTDOWN:
                return Error.ACCESS
            self.set(table.goal_position, self.get(table.present_position))  # hold the present position
            self.set(table.goal_velocity, 0)
        self.set(item, value)
        return Error.NONE

    def _allowed(self, item: Item) -> Container[int]:
        table, (lowest, highest) = self.model.table, self.model.goals
        if item == table.torque_enable:
            return (0, 1)
        if item == table.operating_mode:
            return tuple(OperatingMode)
        if item == table.goal_position and self.mode == OperatingMode.POSITION:
            return range(lowest, highest + 1)
        return range(-(2**31), 2**31)

    def reboot(self) -> None:
        """Restart: torque off, errors cleared until detected again."""
        table = self.model.table
        for item in (table.torque_enable, table.hardware_error, table.goal_velocity):
            self.set(item, 0)

    @property
    def torque(self) -> bool:
        return bool(self.get(self.model.table.torque_enable))

    @property
    def mode(self) -> int:
        return self.get(self.model.table.operating_mode)

    @property
    def goal_position(self) -> int:
        return self.get(self.model.table.goal_position)

    @property
    def goal_velocity(self) -> float:
        """Goal velocity [rad/s]."""
        return self.get(self.model.table.goal_velocity) * self.model.velocity_unit

    @property
    def alert(self) -> int:
        """``Error.ALERT`` during a hardware error, else 0."""
        return int(Error.ALERT) if self.get(self.model.table.hardware_error) else 0

    def measure(self, position: float, velocity: float, torque: float, now: float) -> None:
        """Store encoder steps, velocity [rad/s] and torque [N·m] at ``now`` [s]; an overheated servo shuts down."""
        model, table = self.model, self.model.table
        self.set(table.realtime_tick, int(now * 1e3) % 32768)
        self.set(table.present_position, round(position))
        self.set(table.present_velocity, round(velocity / model.velocity_unit))
        self.set(table.present_effort, self._effort(torque))
        self.set(table.present_voltage, round(10 * self.voltage))
        self.set(table.present_temperature, min(255, round(self.temperature)))
        if self.temperature >= model.temperature_limit:
            self.set(table.hardware_error, self.get(table.hardware_error) | HardwareError.OVERHEATING)
            self.set(table.torque_enable, 0)

    def _effort(self, torque: float) -> int:
        """Present Current for a torque [N·m]; Present Load, at most 100.0 %, of a model without a current sensor."""
        share = torque / self.model.torque
        if self.model.current_unit is None:
            return round(1000 * min(max(share, -1.0), 1.0))
        return round(share * self.model.current / self.model.current_unit)


class DynamixelBus:
    """Processes frames of the driver. Attribute ``servos``: powered servos by id."""

    def __init__(self, servos: Sequence[Servo]) -> None:
        self.servos = {servo.id: servo for servo in servos}
        self._frames = FrameStream(HEADER, PREFIX, _size, _is_valid)

    def receive(self, data: bytes) -> list[Status]:
        """Process received bytes; returns the responses in the order of transmission."""
        return [
            status
            for frame in self._frames.feed(data)
            for status in self._process(frame[4], frame[PREFIX:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"))
        ]

    def _process(self, target: int, body: bytes) -> list[Status]:
        """Process a frame: ``body`` is instruction and parameters."""
        instruction, parameters = body[0], body[1:]
        if target == BROADCAST:
            return self._broadcast(instruction, parameters)
        servo = self.servos.get(target)
        if servo is None or instruction == Instruction.STATUS:  # response of a servo
            return []
        return [self._execute(servo, instruction, parameters)]

    def _broadcast(self, instruction: int, parameters: bytes) -> list[Status]:
        if instruction == Instruction.SYNC_READ and len(parameters) > 4:
            named = [self.servos[servo] for servo in parameters[4:] if servo in self.servos]
            return [self._execute(servo, Instruction.READ, parameters[:4]) for servo in named]
        if instruction == Instruction.SYNC_WRITE and len(parameters) > 4:
            address, size = (int.from_bytes(parameters[i : i + 2], "little") for i in (0, 2))
            for start in range(4, len(parameters) - size, size + 1):
                if servo := self.servos.get(parameters[start]):
                    servo.write(address, parameters[start + 1 : start + 1 + size])
        return []

    def _execute(self, servo: Servo, instruction: int, parameters: bytes) -> Status:
        data, error = b"", Error.NONE
        match instruction:
            case Instruction.PING:
                table = servo.model.table
                data = servo.get(table.model_number).to_bytes(2, "little") + bytes((servo.get(table.firmware),))
            case Instruction.READ if len(parameters) == 4:
                content = servo.read(*(int.from_bytes(parameters[i : i + 2], "little") for i in (0, 2)))
                data, error = (b"", Error.DATA_RANGE) if content is None else (content, Error.NONE)
            case Instruction.WRITE if len(parameters) > 2:
                error = servo.write(int.from_bytes(parameters[:2], "little"), parameters[2:])
            case Instruction.REBOOT:
                servo.reboot()
            case Instruction.READ | Instruction.WRITE:
                error = Error.DATA_LENGTH
            case _:
                error = Error.INSTRUCTION
        return Status(servo.id, encode(servo.id, Instruction.STATUS, bytes((error | servo.alert,)) + data))


def encode(servo: int, instruction: int, parameters: bytes) -> bytes:
    body = stuffed(bytes((instruction,)) + parameters)
    frame = HEADER + bytes((servo,)) + (len(body) + 2).to_bytes(2, "little") + body
    return frame + _crc(frame).to_bytes(2, "little")


def stuffed(body: bytes) -> bytes:
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def _size(prefix: bytearray) -> int:
    length = int.from_bytes(prefix[5:PREFIX], "little")
    return PREFIX + length if 3 <= length <= MAX_LENGTH else 0


def _is_valid(frame: bytes) -> bool:
    return _crc(frame[:-2]) == int.from_bytes(frame[-2:], "little")


def _crc(data: bytes) -> int:
    crc: int = Protocol2PacketHandler().updateCRC(0, data, len(data))
    return crc


ADAPTER = "port"  # unit in front of all servos; unplugged, the port disappears
# Values of the faults.
JUMP = 0.5  # of an encoder [rad]
WARM, HOT = 32.0, 90.0  # normal, and in the fault [°C]
WEAK_SUPPLY = 40.0 / 48.0  # of the nominal voltage
SAMPLING_PERIOD = 0.02  # longest time between samples of the joints, without received data [s]


class _JointServo:
    """Servo and its joint."""

    def __init__(self, table: DynamixelServo, robot: RobotDescription) -> None:
        self.table = table
        self.name = table.joint
        self.model = MODELS[table.model]
        self.servo = Servo(table.id, self.model, table.firmware)
        self.joint = np.array([robot.index[table.joint]], dtype=np.intp)
        self.dead = False  # no power
        self.turned = 0.0  # position set-point in velocity mode [rad]
        self.jump = 0.0  # encoder error [rad]
        self.time: float | None = None  # latest sample of its joint [s of robot time]
        self.state: tuple[object, ...] = ()  # servo state at the last motor command


class DynamixelEmulator(Emulator):
    """All servos of a device. Units are named after their joints; ``port`` is the common adapter."""

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, Dynamixel)
        self._servos = [_JointServo(each, robot) for each in table.servos]
        super().__init__(name, dict.fromkeys((*(servo.name for servo in self._servos), ADAPTER), ALL_FAULTS))
        self._port = SerialPort(serial_port(instance, settings, name))
        self._line = FaultyLine(self._port.write, self.faults)
        self._bus = DynamixelBus([each.servo for each in self._servos])
        self._sampled = -math.inf

    def files(self) -> tuple[int, ...]:
        return (self._port.fileno(),)

    def close(self) -> None:
        self._port.close()

    def step(self, now: float, robot: SimulatedRobot) -> None:
        """Sample the joints, process received frames, send responses and command the motors."""
        if self.faults.active(ADAPTER, EmulatedFault.UNPLUGGED, now):
            self._port.unplug()
        else:
            self._port.plug()
        received = self._port.read()
        if received or now - self._sampled >= SAMPLING_PERIOD:
            self._sampled = now
            for each in self._servos:
                self._power(each, now)
                self._measure(each, now, robot)
            self._bus.servos = {each.table.id: each.servo for each in self._servos if not each.dead}
            names = {each.table.id: each.name for each in self._servos}
            adapter_fails = any(self.faults.active(ADAPTER, fault, now) for fault in EmulatedFault)
            for status in self._bus.receive(received):
                unit = ADAPTER if adapter_fails else names[status.servo]
                self._line.send(unit, status.frame, now)
            for each in self._servos:
                self._drive(each, robot)
        self._line.flush(now)

    def _has(self, each: _JointServo, fault: EmulatedFault, now: float) -> bool:
        return self.faults.active(each.name, fault, now) or self.faults.active(ADAPTER, fault, now)

    def _power(self, each: _JointServo, now: float) -> None:
        """Update whether a servo has power; a servo starts from its default registers."""
        dead = self.faults.active(each.name, EmulatedFault.UNPLUGGED, now)
        if dead != each.dead:
            each.dead = dead
            each.servo = Servo(each.table.id, each.model, each.table.firmware)

    def _measure(self, each: _JointServo, now: float, robot: SimulatedRobot) -> None:
        measured, servo = robot.recent, each.servo
        # Rotation follows robot time, which is slower than the wall clock on an overloaded computer.
        elapsed = 0.0 if each.time is None else robot.time - each.time
        each.time = robot.time
        position, velocity, effort = (
            each.table.direction * float(values[each.joint][0])
            for values in (measured.joint_position, measured.joint_velocity, measured.joint_effort)
        )
        if servo.torque and servo.mode == OperatingMode.VELOCITY:
            each.turned += servo.goal_velocity * elapsed
        servo.temperature = HOT if self._has(each, EmulatedFault.OVER_TEMPERATURE, now) else WARM
        weak = self._has(each, EmulatedFault.UNDER_VOLTAGE, now)
        servo.voltage = each.model.voltage * (WEAK_SUPPLY if weak else 1.0)
        each.jump = JUMP if self._has(each, EmulatedFault.ENCODER_JUMP, now) else 0.0
        servo.measure(each.table.zero + (position + each.jump) / each.model.position_unit, velocity, effort, now)

    def _drive(self, each: _JointServo, robot: SimulatedRobot) -> None:
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
        vectors = {"position": direction * goal, "velocity": direction * velocity}
        robot.command(each.joint, JointMode.POSITION, vectors | dict.fromkeys(("effort", "stiffness", "damping"), 0.0))
