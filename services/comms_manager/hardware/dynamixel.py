"""Dynamixel servos on one serial bus: pan and tilt of the head, the lidar that spins, arms.

In each cycle of the device's rate all servos are read at once and all set-points are written at once. Servos hold
positions on their own. They support the modes off and position; all other modes act as position.
"""

import contextlib
import logging
import time
from threading import Event

import numpy as np

from valor.common.messages import JointMode
from valor.comms_manager.hardware.condition import require_identity
from valor.comms_manager.hardware.device import Device, DeviceContext, DeviceError, Fault, JointMeasurement, UnitFault
from valor.comms_manager.hardware.dynamixel_port import DynamixelError, DynamixelPort, StatusReader
from valor.comms_manager.hardware.dynamixel_servo import Servo
from valor.devices.dynamixel import MODELS, ControlTable, Dynamixel, HardwareError, Item, OperatingMode
from valor.devices.ports import serial_port

ABSENT_AFTER = 5  # cycles without a response, after which a servo is not read
LONGEST_READ = 0.02  # of all servos, missing ones included; the timeout is 7 ms per kind [s]
SEEK_PERIOD = 0.5  # period of searching for a missing servo or port [s]
_log = logging.getLogger("comms_manager")


class DynamixelServos(Device):
    """All servos on one port."""

    def __init__(self, name: str, context: DeviceContext) -> None:
        super().__init__(name, context)
        robot, table = context.robot, context.robot.tables.devices[name]
        assert isinstance(table, Dynamixel)
        self._path = serial_port(context.instance, context.settings, name)
        self._baud_rate = table.baud_rate
        self._servos = [Servo(each, name, row, robot) for row, each in enumerate(table.servos)]
        self._by_id = {servo.table.id: servo for servo in self._servos}
        self.records = tuple(servo.record for servo in self._servos)
        self.rate = table.rate
        self.silent_after = max(0.05, 6.0 / table.rate)
        self._period = 1.0 / table.rate
        self._port: DynamixelPort | None = None
        self._readers: list[StatusReader] = []
        self._enabled = False
        self._gone: tuple[UnitFault, ...] = ()

    def find(self) -> None:
        """Check every servo's model, firmware, state and position; none moves."""
        self._open()
        for servo in self._servos:
            try:
                self._identify(servo)
                self._prepare(servo)
                self._require_calibration_pose(servo)
            except DynamixelError as error:
                raise DeviceError(f"{servo.name}: {error}; expected a {servo.table.model}") from None
        self._group()
        deadline = time.monotonic() + 2.0
        while not all(record.states for record in self.records):
            if time.monotonic() > deadline:
                mute = next(servo for servo in self._servos if not servo.record.states)
                raise DeviceError(f"{mute.name}: identity received, but no response when all are read")
            self._read()

    def enable(self) -> None:
        """Switch the motors on, servo after servo, at their positions; spinning ones start."""
        for servo in self._servos:
            try:
                self._switch_on(servo)
            except DynamixelError as error:
                raise DeviceError(f"{servo.name}: {error}; expected its motor to be on") from None
        self._enabled = True

    def close(self) -> None:
        """Stop spinning servos, and close the port; the others hold, so that no head or arm falls."""
        if self._port is not None:
            with contextlib.suppress(DynamixelError, OSError):  # a missing servo cannot be stopped
                for servo in self._servos:
                    if servo.spins and servo.present:
                        self._port.write(servo.table.id, servo.registers.goal_velocity, 0)
            self._port.close()
            self._port = None

    def _open(self) -> None:
        try:
            self._port = DynamixelPort(str(self._path), self._baud_rate)
        except (OSError, DynamixelError) as error:
            raise DeviceError(
                f"{self.name}: {self._path} cannot be opened: {error}; expected {len(self._servos)} servos there"
            ) from None

    def _read_item(self, servo: Servo, item: Item) -> int:
        assert self._port is not None
        return self._port.read(servo.table.id, item)

    def _write_item(self, servo: Servo, item: Item, value: int) -> None:
        assert self._port is not None
        self._port.write(servo.table.id, item, value)

    def _identify(self, servo: Servo) -> None:
        assert self._port is not None
        number, firmware = self._port.ping(servo.table.id)
        model = next((name for name, model in MODELS.items() if model.number == number), f"number {number}")
        require_identity(servo.name, servo.table, model=model, firmware=firmware)

    def _prepare(self, servo: Servo) -> None:
        """Require no hardware error, and set the operating mode."""
        registers = servo.registers
        if errors := HardwareError(self._read_item(servo, registers.hardware_error)):
            names = " and ".join(str(each.name).lower().replace("_", " ") for each in errors)
            raise DeviceError(f"{servo.name}: {names} error; expected no hardware error")
        mode = OperatingMode.VELOCITY if servo.spins else OperatingMode.POSITION
        servo.torque = bool(self._read_item(servo, registers.torque_enable))
        if self._read_item(servo, registers.operating_mode) != mode:
            self._write_item(servo, registers.torque_enable, 0)
            self._write_item(servo, registers.operating_mode, mode)
            servo.torque = False

    def _require_calibration_pose(self, servo: Servo) -> None:
        """Require the calibration pose of a servo that has not been switched on since power-on."""
        tables, joint = self.context.robot.tables, servo.table.joint
        position = servo.angle(self._read_item(servo, servo.registers.present_position))
        expected = (tables.nominal_posture | tables.calibration.pose).get(joint, 0.0)
        tolerance = tables.calibration.tolerance
        if not servo.spins and not servo.torque and abs(position - expected) > tolerance:
            raise DeviceError(
                f"{servo.name}: at {position:.3f} rad; expected {expected:.3f} ± {tolerance:g} in the "
                f"calibration pose (robot.yaml: zero {servo.table.zero})"
            )

    def _switch_on(self, servo: Servo) -> None:
        """Switch its motor on: it holds its position, or starts to spin."""
        self._write_item(servo, servo.registers.torque_enable, 1)
        if servo.table.spin is not None:
            speed = round(servo.table.direction * servo.table.spin / servo.model.velocity_unit)
            self._write_item(servo, servo.registers.goal_velocity, speed)
        servo.switched(True)

    def _group(self) -> None:
        """Make readers for the present servos, one per control table."""
        assert self._port is not None
        by_table: dict[ControlTable, list[int]] = {}
        for servo in self._servos:
            if servo.present:
                by_table.setdefault(servo.registers, []).append(servo.table.id)
        self._readers = [self._port.reader(registers.feedback, servos) for registers, servos in by_table.items()]

    def run(self, stopping: Event) -> None:
        due = sought = time.monotonic()
        while not stopping.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            due = max(due + self._period, now)
            try:
                if self._port is None:
                    self.looks += 1
                else:
                    self._read()
                    self._write()
                if now - sought > SEEK_PERIOD:
                    sought = now
                    self._find_port() if self._port is None else self._attend()
            except OSError:  # also pyserial's
                self._lose_port()
            except (DynamixelError, DeviceError) as error:
                _log.debug("%s: %s", self.name, error)  # a missing response shows as a timeout of states
            finally:
                self.report_faults(
                    [*self._gone, *(unit_fault for servo in self._servos for unit_fault in servo.unit_faults)]
                )

    def _read(self) -> None:
        began = time.monotonic()
        for reader in self._readers:
            requested = time.monotonic()
            answers = reader.read()
            received = time.monotonic_ns()
            for number in tuple(reader.data_dict):
                servo = self._by_id[number]
                answer = answers.get(number)
                if answer is None:
                    self._miss(servo, reader)
                elif servo.process(answer, received, self._must_be_on(servo)):
                    servo.missed = 0
                    servo.record.received(received)
                    servo.record.answered(1e-9 * received - requested)
                else:
                    servo.record.errors += 1
            self._count_corrupt(reader)
        fields = ("stamp", "position", "velocity", "effort")
        self.joint_state = JointMeasurement(*(np.array([getattr(servo, f) for servo in self._servos]) for f in fields))
        if time.monotonic() - began < LONGEST_READ:  # otherwise this thread, or the line's kernel worker, was delayed
            self.looks += 1

    def _count_corrupt(self, reader: StatusReader) -> None:
        """Count corrupt frames as errors of the servos without a response."""
        if reader.corrupt:
            missing = [self._by_id[number] for number in reader.data_dict if self._by_id[number].missed]
            for servo in missing or self._servos[:1]:
                servo.record.errors += 1
            reader.corrupt = 0

    def _miss(self, servo: Servo, reader: StatusReader) -> None:
        """Count a missing response; after several, the servo is not read, as it delays the others."""
        servo.missed += 1
        if servo.missed >= ABSENT_AFTER:
            servo.present = False
            reader.removeParam(servo.table.id)

    def _write(self) -> None:
        """Send the latest set-points to all present servos that are on."""
        assert self._port is not None
        command = self.command
        if command is None or not self._enabled:
            return
        goals: dict[Item, dict[int, int]] = {}
        for servo in self._servos:
            if not servo.present or not servo.torque or servo.spins:
                continue
            if command.mode[servo.row] == JointMode.OFF:
                self._write_item(servo, servo.registers.torque_enable, 0)
                servo.switched(False)
                continue
            steps = servo.next_goal(float(command.position[servo.row]), self._period)
            goals.setdefault(servo.registers.goal_position, {})[servo.table.id] = steps
        for item, values in goals.items():
            self._port.write_all(item, values)

    def _attend(self) -> None:
        """Search for missing servos; switch servos on again that switched themselves off, if commanded and fit."""
        for servo in self._servos:
            try:
                if not servo.present:
                    self._use_again(servo)
                if servo.alert:  # the error may have switched it off
                    servo.torque = bool(self._read_item(servo, servo.registers.torque_enable))
                if self._must_be_on(servo) and not servo.torque and not servo.jumped and servo.is_fit:
                    self._revive(servo)
            except (DynamixelError, DeviceError) as error:
                _log.debug("%s: %s", servo.name, error)  # it shows as a timeout of states

    def _use_again(self, servo: Servo) -> None:
        self._identify(servo)
        servo.torque = bool(self._read_item(servo, servo.registers.torque_enable))
        servo.present, servo.missed = True, 0
        servo.reset()
        self._group()

    def _revive(self, servo: Servo) -> None:
        """Switch a servo on again; one with a hardware error is rebooted first."""
        assert self._port is not None
        if self._read_item(servo, servo.registers.hardware_error):
            self._port.reboot(servo.table.id)
            servo.reset()
        self._prepare(servo)
        self._switch_on(servo)

    def _must_be_on(self, servo: Servo) -> bool:
        command = self.command
        return self._enabled and command is not None and command.mode[servo.row] != JointMode.OFF

    def _lose_port(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None
        self._gone = tuple(
            UnitFault(servo.record.unit, Fault.UNPLUGGED, f"{self._path} is gone") for servo in self._servos
        )

    def _find_port(self) -> None:
        """Open the port again; ``_attend`` then searches for its servos."""
        self._open()
        for servo in self._servos:
            servo.present = False
        self._readers = []
        self._gone = ()
