"""Dynamixel servos on one serial bus: pan and tilt of the head, the lidar that spins, arms.

In each cycle of the device's rate all servos are read at once and all set-points are written at once. Servos hold
positions by themselves: of a Motor's modes they know off and position; whatever else is asked for holds a position too.
"""

from __future__ import annotations

import contextlib
import logging
import time
from threading import Event

import numpy as np
import serial

from valor.common.messages import JointMode
from valor.comms_manager.hardware import dynamixel_commissioning as commissioning
from valor.comms_manager.hardware.device import (
    Ailment,
    Device,
    DeviceContext,
    DeviceError,
    Fault,
    JointMeasurement,
)
from valor.comms_manager.hardware.dynamixel_port import DynamixelError, DynamixelPort, StatusReader
from valor.comms_manager.hardware.dynamixel_servo import Servo
from valor.devices.dynamixel import ControlTable, Dynamixel, Item
from valor.devices.ports import serial_port

ABSENT_AFTER = 5  # cycles without an answer, after which nobody waits for a servo any more
LONGEST_READ = 0.02  # of all servos, whoever is missing; the time-out is 7 ms for each kind [s]
SEEK_PERIOD = 0.5  # between attempts to find a servo or a port that is gone [s]
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
        self._readers: dict[ControlTable, StatusReader] = {}
        self._enabled = False
        self._gone: tuple[Ailment, ...] = ()

    # --- start and end ------------------------------------------------------------------------------------------------

    def find(self) -> None:
        """Check every servo's model, firmware, state and place; none moves."""
        self._open()
        assert self._port is not None
        for servo in self._servos:
            try:
                commissioning.identify(self._port, servo)
                commissioning.prepare(self._port, servo)
                commissioning.check_place(self._port, servo, self.context.robot.tables)
            except DynamixelError as error:
                raise DeviceError(f"{servo.name}: {error}; expected a {servo.table.model}") from None
        self._group()
        deadline = time.monotonic() + 2.0
        while not all(record.states for record in self.records):
            if time.monotonic() > deadline:
                mute = next(servo for servo in self._servos if not servo.record.states)
                raise DeviceError(f"{mute.name}: it says who it is, but does not answer when all are read")
            self._read()

    def enable(self) -> None:
        """Switch the motors on, servo after servo, where they are; those that spin begin to."""
        assert self._port is not None
        for servo in self._servos:
            try:
                commissioning.switch_on(self._port, servo)
            except DynamixelError as error:
                raise DeviceError(f"{servo.name}: {error}; expected its motor to be on") from None
        self._enabled = True

    def close(self) -> None:
        """Stop what spins, and close the port; the others hold where they are, so that no head or arm falls."""
        if self._port is not None:
            with contextlib.suppress(DynamixelError, serial.SerialException, OSError):  # who is gone cannot be stopped
                for servo in self._servos:
                    if servo.spins and servo.present:
                        self._port.write(servo.table.id, servo.registers.goal_velocity, 0)
            self._port.close()
            self._port = None
        super().close()

    def _open(self) -> None:
        try:
            self._port = DynamixelPort(str(self._path), self._baud_rate)
        except (serial.SerialException, OSError, DynamixelError) as error:
            raise DeviceError(
                f"{self.name}: {self._path} cannot be opened: {error}; expected {len(self._servos)} servos there"
            ) from None

    def _group(self) -> None:
        """Readers for the servos that are there, one a control table."""
        assert self._port is not None
        by_table: dict[ControlTable, list[int]] = {}
        for servo in self._servos:
            if servo.present:
                by_table.setdefault(servo.registers, []).append(servo.table.id)
        self._readers = {
            registers: self._port.reader(registers.feedback, servos) for registers, servos in by_table.items()
        }

    # --- the thread ---------------------------------------------------------------------------------------------------

    def run(self, stopping: Event) -> None:
        """Read and write in every cycle until told to stop; look for what is gone."""
        due = sought = time.monotonic()
        while not stopping.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            due = max(due + self._period, now)
            try:
                if self._port is None:
                    self.looks += 1
                    if now - sought > SEEK_PERIOD:
                        sought = now
                        self._find_port()
                    continue
                self._read()
                self._write()
                if now - sought > SEEK_PERIOD:
                    sought = now
                    self._tend()
            except (serial.SerialException, OSError):
                self._lose_port()
            except (DynamixelError, DeviceError) as error:
                _log.debug("%s: %s", self.name, error)  # who did not answer is missed by its states
            finally:
                self.tell([*self._gone, *(ailment for servo in self._servos for ailment in servo.ailments)])

    def _read(self) -> None:
        """Ask all servos for their states and take in what they answer."""
        began = time.monotonic()
        for reader in self._readers.values():
            asked = time.monotonic()
            answers = reader.read()
            came = time.monotonic_ns()
            for number in tuple(reader.data_dict):
                servo = self._by_id[number]
                answer = answers.get(number)
                if answer is None:
                    self._miss(servo, reader)
                elif servo.take(answer, came, self._is_wanted(servo)):
                    servo.missed = 0
                    servo.record.received(came)
                    servo.record.answered(1e-9 * came - asked)
                else:
                    servo.record.errors += 1
            self._blame(reader)
        servos = self._servos
        self.joint_state = JointMeasurement(
            np.array([servo.stamp for servo in servos]),
            np.array([servo.position for servo in servos]),
            np.array([servo.velocity for servo in servos]),
            np.array([servo.effort for servo in servos]),
        )
        if time.monotonic() - began < LONGEST_READ:  # otherwise this thread, or the line's kernel worker, was held up
            self.looks += 1

    def _blame(self, reader: StatusReader) -> None:
        """Frames that could not be read are those of whoever is missing."""
        if reader.corrupt:
            missing = [self._by_id[number] for number in reader.data_dict if self._by_id[number].missed]
            for servo in missing or self._servos[:1]:
                servo.record.errors += 1
            reader.corrupt = 0

    def _miss(self, servo: Servo, reader: StatusReader) -> None:
        """Nobody waits for ever: the others' states would be late."""
        servo.missed += 1
        if servo.missed >= ABSENT_AFTER:
            servo.present = False
            reader.removeParam(servo.table.id)

    def _write(self) -> None:
        """Send the newest set-points to all servos that obey."""
        assert self._port is not None
        command = self.command
        if command is None or not self._enabled:
            return
        goals: dict[Item, dict[int, int]] = {}
        for servo in self._servos:
            if not servo.present or not servo.torque or servo.spins:
                continue
            if command.mode[servo.row] == JointMode.OFF:
                self._switch_off(servo)
                continue
            steps = servo.next_goal(float(command.position[servo.row]), self._period)
            goals.setdefault(servo.registers.goal_position, {})[servo.table.id] = steps
        for item, values in goals.items():
            self._port.write_all(item, values)

    def _switch_off(self, servo: Servo) -> None:
        assert self._port is not None
        self._port.write(servo.table.id, servo.registers.torque_enable, 0)
        servo.switched_off()

    def _tend(self) -> None:
        """Look for servos that are gone; switch on again what went off by itself, once it is well and wanted."""
        assert self._port is not None
        for servo in self._servos:
            try:
                if not servo.present:
                    self._welcome(servo)
                if servo.alert:  # what is wrong may have switched it off
                    servo.torque = commissioning.is_on(self._port, servo)
                if self._is_wanted(servo) and not servo.torque and not servo.jumped:
                    commissioning.revive(self._port, servo)
            except (DynamixelError, DeviceError) as error:
                _log.debug("%s: %s", servo.name, error)  # it is missed by its states

    def _welcome(self, servo: Servo) -> None:
        """Take a servo back that had been gone, if it is the same one."""
        assert self._port is not None
        commissioning.identify(self._port, servo)
        servo.torque = commissioning.is_on(self._port, servo)
        servo.present, servo.missed = True, 0
        servo.forget()
        self._group()

    def _is_wanted(self, servo: Servo) -> bool:
        """Whether its motor shall be on."""
        command = self.command
        return self._enabled and command is not None and command.mode[servo.row] != JointMode.OFF

    def _lose_port(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None
        self._gone = tuple(
            Ailment(servo.record.unit, Fault.UNPLUGGED, f"{self._path} is gone") for servo in self._servos
        )

    def _find_port(self) -> None:
        """Open the port again; the servos behind it are looked for one by one."""
        self._open()
        for servo in self._servos:
            servo.present = False
        self._readers = {}
        self._gone = ()
