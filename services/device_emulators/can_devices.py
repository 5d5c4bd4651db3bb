"""Emulated devices on CAN buses: base class, force/torque sensors and series-elastic motor controllers."""

from abc import abstractmethod
from collections.abc import Sequence
from itertools import groupby

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.instance import Instance, Settings
from valor.device_emulators.emulator import ALL_FAULTS, EmulatedFault, Emulator, FaultyLine
from valor.device_emulators.robot import SimulatedRobot
from valor.devices import can_frames
from valor.devices.can_frames import AXES, Code, Frame, Identity, Status, is_command, protect
from valor.devices.ports import open_can
from valor.devices.table import FtCan, MotorController, SeaCanFd, WrenchSensor
from valor.robot.description import RobotDescription

WATCHDOG = 0.1  # age of the last command at which a controller holds its joints [s]
JUMP = 0.5  # of the first axis' encoder, in the fault [rad]
WARM, HOT = 30.0, 90.0  # normal, and in the fault [°C]
WEAK_SUPPLY = 40.0  # in the fault [V]
TORQUE_PER_CURRENT = 12.0  # of the motor, at the joint [N·m/A]

_SENSOR_FAULTS = ALL_FAULTS - {EmulatedFault.ENCODER_JUMP, EmulatedFault.UNDER_VOLTAGE}


class CanEmulator(Emulator):
    """Units on one bus. Each unit samples and responds on SYNC."""

    def __init__(
        self,
        name: str,
        settings: Settings,
        bus: int,
        units: Sequence[MotorController | WrenchSensor],
        kinds: frozenset[EmulatedFault] = ALL_FAULTS,
    ) -> None:
        """``units``: on the bus, named by their numbers; ``kinds``: faults that can be injected."""
        self._identities = {unit.id: Identity(unit.serial, unit.firmware) for unit in units}
        self._names = {unit.id: str(unit.id) for unit in units}
        super().__init__(name, dict.fromkeys(self._names.values(), kinds))
        self._bus = open_can(settings, bus, master=False)
        self._out: list[Frame] = []  # sent together: the driver wakes up once
        self._line = FaultyLine(lambda *frame: self._out.append(Frame(*frame)), self.faults)
        self._dead: set[int] = set()

    def files(self) -> tuple[int, ...]:
        return (self._bus.fileno(),)

    def close(self) -> None:
        self._bus.close()

    def step(self, now: float, robot: SimulatedRobot) -> None:
        if self.faults or self._dead:
            for unit, name in self._names.items():
                if self.faults.active(name, EmulatedFault.UNPLUGGED, now) != (unit in self._dead):
                    self._dead ^= {unit}
                    self._power_changed(unit, unit not in self._dead, robot)
        for kind, frames in groupby(self._bus.receive(0.0), lambda frame: frame.identifier & can_frames.KIND):
            if kind == can_frames.COMMAND:
                self._command([frame for frame in frames if self._has(frame)], now, robot)
            elif kind == can_frames.SYNC:
                for frame in frames:
                    self._sample(frame, now, robot)
            elif kind == can_frames.REQUEST:
                for frame in frames:
                    self._reply(frame, now, robot)
        self._check_watchdogs(now, robot)
        self._line.flush(now)
        if self._out:
            self._bus.send(self._out)
            self._out.clear()

    def _has(self, frame: Frame) -> bool:
        """Return whether a frame is to a unit that has power."""
        unit = frame.identifier & can_frames.UNIT
        return unit in self._identities and unit not in self._dead

    def _sample(self, frame: Frame, now: float, robot: SimulatedRobot) -> None:
        if (counter := can_frames.read_small(frame)) is None:
            return
        for (unit, name), state in zip(self._names.items(), self._states(counter, now, robot), strict=True):
            if unit not in self._dead:
                identifier = can_frames.STATE + unit
                self._line.send(name, protect(identifier, state), now, identifier)

    def _reply(self, frame: Frame, now: float, robot: SimulatedRobot) -> None:
        unit = frame.identifier & can_frames.UNIT
        if self._has(frame) and (code := can_frames.read_small(frame)) is not None:
            done = code == Code.IDENTIFY or self._execute(unit, code, now, robot)
            if not self.faults.active(self._names[unit], EmulatedFault.SILENT, now):
                self._out.append(can_frames.reply(unit, code, done, self._identities[unit]))

    @abstractmethod
    def _states(self, counter: int, now: float, robot: SimulatedRobot) -> list[bytes]:
        """Contents of all units' STATE frames."""

    def _power_changed(self, unit: int, on: bool, robot: SimulatedRobot) -> None:
        """Handle loss or return of a unit's supply; default: none."""

    def _execute(self, unit: int, code: int, now: float, robot: SimulatedRobot) -> bool:
        """Execute a request other than IDENTIFY; returns whether it succeeded."""
        return False

    def _command(self, frames: Sequence[Frame], now: float, robot: SimulatedRobot) -> None:
        """Apply COMMANDs; sensors ignore them."""

    def _check_watchdogs(self, now: float, robot: SimulatedRobot) -> None:
        """Hold the joints of units without recent commands."""


class ForceTorqueEmulator(CanEmulator):
    """Force/torque sensors in feet and wrists, on one CAN bus."""

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, FtCan)
        super().__init__(name, settings, table.bus, table.sensors, _SENSOR_FAULTS)
        self._wrenches = {str(unit.id): f"{unit.at}_wrench" for unit in table.sensors}

    def _states(self, counter: int, now: float, robot: SimulatedRobot) -> list[bytes]:
        states, measured = [], robot.measured
        for name, wrench in self._wrenches.items():
            hot = self.faults.active(name, EmulatedFault.OVER_TEMPERATURE, now)
            status, temperature = (Status.OVER_TEMPERATURE, HOT) if hot else (0, WARM)
            values: FloatArray = getattr(measured, wrench)
            states.append(can_frames.SENSOR_STATE.pack(counter, status, round(10.0 * temperature), *values.tolist()))
        return states


# As plain numbers: flag arithmetic is slow.
_ENABLED, _CALIBRATED, _WATCHDOG = int(Status.ENABLED), int(Status.CALIBRATED), int(Status.WATCHDOG)
_HOT, _WEAK = int(Status.OVER_TEMPERATURE), int(Status.UNDER_VOLTAGE)


class _Controller:
    def __init__(self, table: MotorController, robot: RobotDescription, row: int) -> None:
        self.joints = np.array([robot.index[joint] for joint in table.axes], dtype=np.intp)
        self.name = str(table.id)
        self.row = row
        self.status = self.sequence = 0
        self.commanded = 0.0  # time of the last command [s of robot time]


class SeriesElasticEmulator(CanEmulator):
    """Motor controllers of series-elastic actuators on one CAN FD bus."""

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, SeaCanFd)
        super().__init__(name, settings, table.bus, table.controllers)
        self._controllers = {unit.id: _Controller(unit, robot, row) for row, unit in enumerate(table.controllers)}
        self._joints = np.concatenate([each.joints for each in self._controllers.values()])
        self._has_axis = np.array([np.arange(AXES) < each.joints.size for each in self._controllers.values()])
        self._offset = np.zeros(self._has_axis.shape)  # encoder values at joint position 0, (controllers, axes) [rad]
        self._offset[self._has_axis] = [robot.tables.calibration.offsets.get(joint, 0.0) for joint in table.joints]
        self._measured = np.zeros((*self._offset.shape, 4))  # position, velocity, torque, current

    def _states(self, counter: int, now: float, robot: SimulatedRobot) -> list[bytes]:
        measured, joints, places, fault = robot.measured, self._joints, self._has_axis, self.faults.active
        robot.state_requested()
        position = measured.joint_position[joints] + self._encoder_offset(now)[places]
        current = robot.plant.actuators.drive[joints] / TORQUE_PER_CURRENT
        vectors = (position, measured.joint_velocity[joints], measured.joint_effort[joints], current)
        for k, values in enumerate(vectors):
            self._measured[places, k] = values
        clock, states = round(1e6 * robot.time) & 0xFFFFFFFF, []
        rows = self._measured.reshape(-1, 4 * AXES).tolist()
        for controller, axes in zip(self._controllers.values(), rows, strict=True):
            hot = fault(controller.name, EmulatedFault.OVER_TEMPERATURE, now)
            weak = fault(controller.name, EmulatedFault.UNDER_VOLTAGE, now)
            status = controller.status | (_HOT if hot else 0) | (_WEAK if weak else 0)
            temperatures = [round(10.0 * (HOT if hot else WARM))] * AXES
            voltage = round(100.0 * (WEAK_SUPPLY if weak else measured.battery_voltage))
            content = (counter, status, controller.sequence, *axes, *temperatures, voltage, clock)
            states.append(can_frames.CONTROLLER_STATE.pack(*content))
        return states

    def _encoder_offset(self, now: float) -> FloatArray:
        """(controllers, axes) encoder values at joint position 0 [rad]."""
        if not self.faults:
            return self._offset
        offset = self._offset.copy()
        for each in self._controllers.values():
            if self.faults.active(each.name, EmulatedFault.ENCODER_JUMP, now):
                offset[each.row, 0] += JUMP
        return offset

    def _execute(self, unit: int, code: int, now: float, robot: SimulatedRobot) -> bool:
        controller = self._controllers[unit]
        if code == Code.CALIBRATED:
            controller.status |= _CALIBRATED
        elif code == Code.ENABLE and controller.status & _CALIBRATED:
            if not controller.status & _ENABLED:
                controller.status |= _ENABLED
                controller.commanded = robot.time
                robot.power(controller.joints, True)
                robot.hold(controller.joints)
        elif code == Code.DISABLE:
            controller.status &= ~(_ENABLED | _WATCHDOG)
            robot.power(controller.joints, False)
        else:
            return False
        return True

    def _command(self, frames: Sequence[Frame], now: float, robot: SimulatedRobot) -> None:
        controllers = [self._controllers[frame.identifier & can_frames.UNIT] for frame in frames]
        enabled = [(c, f) for c, f in zip(controllers, frames, strict=True) if c.status & _ENABLED and is_command(f)]
        if not enabled:
            return
        commands = can_frames.read_commands([frame for _, frame in enabled])
        for (controller, _), sequence in zip(enabled, commands["sequence"].tolist(), strict=True):
            controller.sequence, controller.commanded = sequence, robot.time
            controller.status &= ~_WATCHDOG
        rows = [controller.row for controller, _ in enabled]
        places, axes = self._has_axis[rows], commands["axis"]
        vectors = {name: axes[name][places] for name in ("position", "velocity", "effort", "stiffness", "damping")}
        vectors["position"] = vectors["position"] - self._encoder_offset(now)[rows][places]
        joints = np.concatenate([controller.joints for controller, _ in enabled])
        robot.command(joints, commands["mode"][places], vectors)

    def _check_watchdogs(self, now: float, robot: SimulatedRobot) -> None:
        for controller in self._controllers.values():
            enabled = controller.status & (_ENABLED | _WATCHDOG) == _ENABLED
            if enabled and robot.time - controller.commanded > WATCHDOG:
                controller.status |= _WATCHDOG
                robot.hold(controller.joints)

    def _power_changed(self, unit: int, on: bool, robot: SimulatedRobot) -> None:
        controller = self._controllers[unit]
        controller.status = controller.sequence = 0
        robot.power(controller.joints, False)
