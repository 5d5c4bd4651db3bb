"""Emulated devices on CAN buses: base class, force/torque sensors and series-elastic motor controllers."""

from abc import abstractmethod
from collections.abc import Sequence

import can
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.instance import Instance, Settings
from valor.device_emulators.emulator import ALL_FAULTS, EmulatedFault, Emulator, FaultyLine
from valor.device_emulators.robot import SimulatedRobot
from valor.devices import can_frames
from valor.devices.can_frames import Code, Identity, Status, protect
from valor.devices.ports import open_can
from valor.devices.table import FtCan, MotorController, SeaCanFd, WrenchSensor
from valor.robot.description import RobotDescription

WATCHDOG = 0.1  # age of the last command at which a controller holds its joints [s]
JUMP = 0.5  # of the first axis' encoder, in the fault [rad]
WARM, HOT = 30.0, 90.0  # normal, and in the fault [°C]
SUPPLY, WEAK_SUPPLY = 48.0, 40.0  # likewise [V]
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
        self._bus = open_can(settings, bus, can_frames.TO_UNITS, can_frames.KIND)
        self._line = FaultyLine(lambda *frame: self._bus.send(can_frames.frame(*frame)), self.faults)
        self._dead: set[int] = set()

    def files(self) -> tuple[int, ...]:
        return (self._bus.fileno(),)

    def close(self) -> None:
        self._bus.shutdown()

    def step(self, now: float, robot: SimulatedRobot) -> None:
        for unit, name in self._names.items():
            if self.faults.active(name, EmulatedFault.UNPLUGGED, now) != (unit in self._dead):
                self._dead ^= {unit}
                self._power_changed(unit, unit not in self._dead, robot)
        while True:
            try:
                message = self._bus.recv(0.0)
            except can.CanOperationError:
                continue  # no CAN frame
            if message is None:
                break
            self._process(message, now, robot)
        self._check_watchdogs(now, robot)
        self._line.flush(now)

    def _process(self, message: can.Message, now: float, robot: SimulatedRobot) -> None:
        identifier = message.arbitration_id
        if identifier == can_frames.SYNC:
            counter = can_frames.read_small(message)
            if counter is not None:
                units = [unit for unit in self._identities if unit not in self._dead]
                # Send all states together: the driver wakes up at the first and finds the others received.
                for unit, state in [(unit, self._state(unit, counter, now, robot)) for unit in units]:
                    self._line.send(self._names[unit], state, now, can_frames.STATE + unit)
            return
        unit = identifier & can_frames.UNIT
        if unit not in self._identities or unit in self._dead:
            return
        kind = identifier & can_frames.KIND
        if kind == can_frames.REQUEST:
            code = can_frames.read_small(message)
            if code is not None:
                done = code == Code.IDENTIFY or self._execute(unit, code, now, robot)
                if not self.faults.active(self._names[unit], EmulatedFault.SILENT, now):
                    self._bus.send(can_frames.reply(unit, code, done, self._identities[unit]))
        elif kind == can_frames.COMMAND:
            self._command(unit, message, now, robot)

    @abstractmethod
    def _state(self, unit: int, counter: int, now: float, robot: SimulatedRobot) -> bytes:
        """Data of a unit's STATE frame."""

    def _power_changed(self, unit: int, on: bool, robot: SimulatedRobot) -> None:
        """Handle loss or return of a unit's supply; default: none."""

    def _execute(self, unit: int, code: int, now: float, robot: SimulatedRobot) -> bool:
        """Execute a request other than IDENTIFY; returns whether it succeeded."""
        return False

    def _command(self, unit: int, message: can.Message, now: float, robot: SimulatedRobot) -> None:
        """Apply a COMMAND; sensors ignore it."""

    def _check_watchdogs(self, now: float, robot: SimulatedRobot) -> None:
        """Hold the joints of units without recent commands."""


class ForceTorqueEmulator(CanEmulator):
    """Force/torque sensors in feet and wrists, on one CAN bus."""

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, FtCan)
        super().__init__(name, settings, table.bus, table.sensors, _SENSOR_FAULTS)
        self._wrenches = {unit.id: f"{unit.at}_wrench" for unit in table.sensors}

    def _state(self, unit: int, counter: int, now: float, robot: SimulatedRobot) -> bytes:
        wrench: FloatArray = getattr(robot.measured, self._wrenches[unit])
        hot = self.faults.active(self._names[unit], EmulatedFault.OVER_TEMPERATURE, now)
        status = Status.OVER_TEMPERATURE if hot else Status(0)
        content = can_frames.SENSOR_STATE.pack(counter, status, round(10.0 * (HOT if hot else WARM)), *wrench)
        return protect(can_frames.STATE + unit, content)


class _Controller:
    def __init__(self, table: MotorController, robot: RobotDescription) -> None:
        self.joints = np.array([robot.index[joint] for joint in table.axes], dtype=np.intp)
        self.offset = np.array([robot.tables.calibration.offsets.get(joint, 0.0) for joint in table.axes])
        self.name = str(table.id)
        self.status = Status(0)
        self.sequence = 0
        self.commanded = 0.0  # time of the last command [s of robot time]


class SeriesElasticEmulator(CanEmulator):
    """Motor controllers of series-elastic actuators on one CAN FD bus."""

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, SeaCanFd)
        super().__init__(name, settings, table.bus, table.controllers)
        self._controllers = {unit.id: _Controller(unit, robot) for unit in table.controllers}

    def _state(self, unit: int, counter: int, now: float, robot: SimulatedRobot) -> bytes:
        controller, measured, fault = self._controllers[unit], robot.measured, self.faults.active
        robot.state_requested()
        position = measured.joint_position[controller.joints] + self._offset(controller, now)
        velocity = measured.joint_velocity[controller.joints]
        torque = measured.joint_effort[controller.joints]
        current = robot.plant.actuators.drive[controller.joints] / TORQUE_PER_CURRENT
        axes: list[float] = []
        for k in range(position.size):
            axes += (float(position[k]), float(velocity[k]), float(torque[k]), float(current[k]))
        axes += [0.0] * (4 * can_frames.AXES - len(axes))
        hot = fault(controller.name, EmulatedFault.OVER_TEMPERATURE, now)
        weak = fault(controller.name, EmulatedFault.UNDER_VOLTAGE, now)
        content = can_frames.CONTROLLER_STATE.pack(
            counter,
            controller.status | (Status.OVER_TEMPERATURE if hot else 0) | (Status.UNDER_VOLTAGE if weak else 0),
            controller.sequence,
            *axes,
            *[round(10.0 * (HOT if hot else WARM))] * can_frames.AXES,
            round(100.0 * (WEAK_SUPPLY if weak else SUPPLY)),
            round(1e6 * robot.time) & 0xFFFFFFFF,
        )
        return protect(can_frames.STATE + unit, content)

    def _offset(self, controller: _Controller, now: float) -> FloatArray:
        """Encoder values at joint position 0 [rad]."""
        if not self.faults.active(controller.name, EmulatedFault.ENCODER_JUMP, now):
            return controller.offset
        jumped = controller.offset.copy()
        jumped[0] += JUMP
        return jumped

    def _execute(self, unit: int, code: int, now: float, robot: SimulatedRobot) -> bool:
        controller = self._controllers[unit]
        if code == Code.CALIBRATED:
            controller.status |= Status.CALIBRATED
        elif code == Code.ENABLE and controller.status & Status.CALIBRATED:
            if not controller.status & Status.ENABLED:
                controller.status |= Status.ENABLED
                controller.commanded = robot.time
                robot.power(controller.joints, True)
                robot.hold(controller.joints)
        elif code == Code.DISABLE:
            controller.status &= ~(Status.ENABLED | Status.WATCHDOG)
            robot.power(controller.joints, False)
        else:
            return False
        return True

    def _command(self, unit: int, message: can.Message, now: float, robot: SimulatedRobot) -> None:
        controller = self._controllers[unit]
        command = can_frames.read_command(message)
        if command is None or not controller.status & Status.ENABLED:
            return
        controller.sequence = int(command["sequence"])
        controller.commanded = robot.time
        controller.status &= ~Status.WATCHDOG
        axes, count = command["axis"], controller.joints.size
        vectors = {name: axes[name][:count] for name in ("position", "velocity", "effort", "stiffness", "damping")}
        vectors["position"] = vectors["position"] - self._offset(controller, now)
        robot.command(controller.joints, command["mode"][:count], vectors)

    def _check_watchdogs(self, now: float, robot: SimulatedRobot) -> None:
        for controller in self._controllers.values():
            enabled = controller.status & (Status.ENABLED | Status.WATCHDOG) == Status.ENABLED
            if enabled and robot.time - controller.commanded > WATCHDOG:
                controller.status |= Status.WATCHDOG
                robot.hold(controller.joints)

    def _power_changed(self, unit: int, on: bool, robot: SimulatedRobot) -> None:
        controller = self._controllers[unit]
        controller.status, controller.sequence = Status(0), 0
        robot.power(controller.joints, False)
