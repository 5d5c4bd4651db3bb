"""Motor controllers of series-elastic actuators: encoders, torque loop, watchdog, temperature."""

from __future__ import annotations

import can
import numpy as np

from valor.common.instance import Instance, Settings
from valor.device_emulators.can_emulator import CanEmulator
from valor.device_emulators.emulator import EmulatedFault
from valor.device_emulators.robot import SimulatedRobot
from valor.devices import can_frames
from valor.devices.can_frames import Code, Status
from valor.devices.end_to_end import protect
from valor.devices.table import MotorController, SeaCanFd
from valor.robot.description import RobotDescription

WATCHDOG = 0.1  # without a command for so long, a controller holds its joints [s]
JUMP = 0.5  # of the first axis' encoder [rad]
FEVER = 90.0  # [°C]
SUPPLY, WEAK_SUPPLY = 48.0, 40.0  # [V]
TORQUE_PER_CURRENT = 12.0  # at the joint [N·m/A]
AMBIENT = 25.0  # [°C]
HEATING = 0.1  # at rest, per current squared [°C/A²]
THERMAL_TIME = 200.0  # [s]


class _Controller:
    """One motor controller's own memory."""

    def __init__(self, table: MotorController, robot: RobotDescription) -> None:
        self.joints = np.array([robot.index[joint] for joint in table.axes], dtype=np.intp)
        self.offset = np.array([robot.tables.calibration.offsets.get(joint, 0.0) for joint in table.axes])
        self.name = str(table.id)
        self.status = Status(0)
        self.sequence = 0
        self.commanded = 0.0  # when a command came last [s of the robot]
        self.temperature = [AMBIENT] * can_frames.AXES
        self.heated = 0.0  # when that was worked out last [s]


class SeriesElasticEmulator(CanEmulator):
    """The motor controllers on one CAN FD bus."""

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table = robot.tables.devices[name]
        assert isinstance(table, SeaCanFd)
        super().__init__(name, settings, table.bus, table.controllers)
        self._controllers = {unit.id: _Controller(unit, robot) for unit in table.controllers}

    def _state(self, unit: int, counter: int, now: float, robot: SimulatedRobot) -> bytes:
        controller, measured, fault = self._controllers[unit], robot.measured, self.faults.active
        robot.asked()
        position = measured.joint_position[controller.joints] + self._offset(controller, now)
        velocity = measured.joint_velocity[controller.joints]
        torque = measured.joint_effort[controller.joints]
        axes: list[float] = []
        elapsed, controller.heated = min(1.0, now - controller.heated), now
        for k in range(can_frames.AXES):
            if k >= position.size:
                axes += (0.0, 0.0, 0.0, 0.0)
                continue
            current = float(torque[k]) / TORQUE_PER_CURRENT
            warmth = AMBIENT + HEATING * current * current - controller.temperature[k]
            controller.temperature[k] += elapsed / THERMAL_TIME * warmth
            axes += (float(position[k]), float(velocity[k]), float(torque[k]), current)
        hot = fault(controller.name, EmulatedFault.OVER_TEMPERATURE, now)
        weak = fault(controller.name, EmulatedFault.UNDER_VOLTAGE, now)
        content = can_frames.CONTROLLER_STATE.pack(
            counter,
            controller.status | (Status.OVER_TEMPERATURE if hot else 0) | (Status.UNDER_VOLTAGE if weak else 0),
            controller.sequence,
            *axes,
            *(round(10.0 * (FEVER if hot else temperature)) for temperature in controller.temperature),
            round(100.0 * (WEAK_SUPPLY if weak else SUPPLY)),
            round(1e6 * robot.time) & 0xFFFFFFFF,
        )
        return protect(can_frames.STATE + unit, content)

    def _offset(self, controller: _Controller, now: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """What the encoders say where the joints are at 0."""
        if not self.faults.active(controller.name, EmulatedFault.ENCODER_JUMP, now):
            return controller.offset
        jumped = controller.offset.copy()
        jumped[0] += JUMP
        return jumped

    def _obey(self, unit: int, code: int, now: float, robot: SimulatedRobot) -> bool:
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
        robot.command(
            controller.joints,
            mode=command["mode"][:count],
            position=axes["position"][:count] - self._offset(controller, now),
            velocity=axes["velocity"][:count],
            effort=axes["effort"][:count],
            stiffness=axes["stiffness"][:count],
            damping=axes["damping"][:count],
        )

    def _pass_time(self, now: float, robot: SimulatedRobot) -> None:
        for controller in self._controllers.values():
            obeys = controller.status & (Status.ENABLED | Status.WATCHDOG) == Status.ENABLED
            if obeys and robot.time - controller.commanded > WATCHDOG:
                controller.status |= Status.WATCHDOG
                robot.hold(controller.joints)

    def _power_changed(self, unit: int, on: bool, robot: SimulatedRobot) -> None:
        controller = self._controllers[unit]
        controller.status, controller.sequence = Status(0), 0
        robot.power(controller.joints, False)
