"""Legs and waist: series-elastic actuators behind motor controllers on CAN FD. The torque loop is the controllers'."""

import math
import time
from collections.abc import Sequence

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.messages import JointMode
from valor.comms_manager.hardware.can_device import CanDevice, CanUnit
from valor.comms_manager.hardware.device import (
    DeviceContext,
    DeviceError,
    Fault,
    JointCommands,
    JointMeasurement,
    UnitFault,
)
from valor.devices import can_frames
from valor.devices.can_frames import Code, Identity
from valor.devices.table import MotorController, SeaCanFd, SupplyLimits

JUMP_MARGIN = 0.05  # margin of a joint's motion between states, in addition to its velocity limit [rad]
JUMPS_TO_FAULT = 3  # consecutive implausible positions, after which the encoder has jumped
LONGEST_STEP = 10_000_000  # of a controller's clock between states; a longer one is a restart [µs]
ENABLE_WITHIN = 0.1  # largest distance from the set-point at which a controller is switched on again [rad]

# As plain numbers: flag arithmetic is slow, and this is done for every state.
_ENABLED = int(can_frames.Status.ENABLED)
_CALIBRATED = int(can_frames.Status.CALIBRATED)
_FAULTS = {
    int(can_frames.Status.ENCODER_FAULT): "it reports a fault of its encoder",
    int(can_frames.Status.INTERNAL_FAULT): "it reports an internal fault",
}
_ANY_FAULT = sum(_FAULTS)


class _Controller(CanUnit):
    """A motor controller; ``rows``: of its axes among the device's joints."""

    def __init__(self, table: MotorController, device: str, first: int, supply: SupplyLimits) -> None:
        super().__init__(table, device, supply)
        self.identity = Identity(table.serial, table.firmware)
        self.rows = range(first, first + len(table.axes))
        self.jumps = 0  # consecutive implausible positions
        self.suspects: list[int] = []  # rows with an implausible position in the latest state
        self.spoke: int | None = None  # its clock in the latest state, plausible or not [µs]
        self.jumped: list[int] = []  # rows whose encoder has jumped
        self.status = 0
        self.clock: int | None = None  # [µs], of its latest state
        self.elapsed = 0  # ``elapsed`` at that state [ns]
        self.identified = True  # its identity is checked; not after a loss of power


class SeriesElastic(CanDevice):
    """All controllers on one bus."""

    def __init__(self, name: str, context: DeviceContext) -> None:
        robot = context.robot
        table = robot.tables.devices[name]
        assert isinstance(table, SeaCanFd)
        self._controllers: dict[int, _Controller] = {}
        first = 0
        for controller in table.controllers:
            self._controllers[controller.id] = _Controller(controller, name, first, robot.tables.supply)
            first += len(controller.axes)
        super().__init__(name, context, table.bus, self._controllers, can_frames.CONTROLLER_STATE_LENGTH)
        m = len(self.joints)
        self._names = table.joints
        calibration = robot.tables.calibration
        self._offset = np.array([calibration.offsets.get(joint, 0.0) for joint in self._names])
        # Lists, whose elements are faster than an array's.
        self._step_limit = (2.0 * robot.velocity_limit[self.joints]).tolist()
        self._stamp = [0] * m
        self._encoder, self._velocity, self._effort = [0.0] * m, [0.0] * m, [0.0] * m
        self._raw = [0.0] * m  # encoder values, plausible or not
        self._commands = np.zeros(len(self._controllers), dtype=can_frames.COMMAND_TYPE)
        # Views of (controllers, axes), and the index of each joint in them.
        axes = self._commands["axis"]
        self._axis = {field: axes[field] for field in ("position", "velocity", "effort", "stiffness", "damping")}
        self._mode = self._commands["mode"]
        self._slots = tuple(
            np.array(
                [(k, axis) for k, unit in enumerate(self._controllers.values()) for axis in range(len(unit.rows))],
                dtype=np.intp,
            ).T
        )
        self._sent: JointCommands | None = None
        self._enabled = False

    def find(self) -> None:
        """Check every controller's identity, and that the joints are in the calibration pose."""
        super().find()
        assert self.joint_state is not None
        robot = self.context.robot
        pose = robot.tables.nominal_posture | robot.tables.calibration.pose
        for unit in self._controllers.values():
            if unit.status & _CALIBRATED:
                continue  # checked since power-on: the robot may be in any pose
            for row in unit.rows:
                position, expected = float(self.joint_state.position[row]), pose.get(self._names[row], 0.0)
                if abs(position - expected) > robot.tables.calibration.tolerance:
                    raise DeviceError(
                        f"{unit.name}: {self._names[row]} is at {position:.3f} rad; expected {expected:.3f} "
                        f"± {robot.tables.calibration.tolerance:g} in the calibration pose "
                        "(robot.yaml: calibration.offsets)"
                    )

    def enable(self) -> None:
        """Switch the motors on, controller after controller; each holds its joints."""
        for unit in self._controllers.values():
            for code in (Code.CALIBRATED, Code.ENABLE):
                if not self._request(unit, code, f"expected a reply to {code.name.lower()}").done:
                    raise DeviceError(f"{unit.name}: it rejects {code.name.lower()}; expected its motors to be on")
        self._enabled = True

    def _take(self, unit: CanUnit, data: bytes) -> bool:
        assert isinstance(unit, _Controller)
        _, status, _, *axes = can_frames.CONTROLLER_STATE.unpack_from(data)
        now = time.monotonic_ns()
        # By its own clock since the last plausible state: a stalled computer does not make jumps plausible.
        elapsed, since = (
            math.inf if clock is None else 1e-6 * ((int(axes[11]) - clock) & 0xFFFFFFFF)
            for clock in (unit.clock, unit.spoke)
        )
        unit.spoke = int(axes[11])
        encoder, raw, most = self._encoder, self._raw, self._step_limit
        # What stays where it jumped has jumped, even if with time a motion might have led there. NaN counts as a jump.
        jumped = [
            row
            for k, row in enumerate(unit.rows)
            if not abs(axes[4 * k] - encoder[row]) <= most[row] * elapsed + JUMP_MARGIN
            or (row in unit.suspects and abs(axes[4 * k] - raw[row]) <= most[row] * since + JUMP_MARGIN)
        ]
        unit.suspects = jumped
        for k, row in enumerate(unit.rows):
            raw[row] = axes[4 * k]
        fresh = [row for row in jumped if row not in unit.jumped]
        if fresh:
            unit.jumps += 1
            if unit.jumps < JUMPS_TO_FAULT:
                return False
            unit.jumped = unit.jumped + fresh
        unit.jumps = 0
        for k, row in enumerate(unit.rows):
            if row in unit.jumped:
                self._velocity[row] = 0.0
            else:
                encoder[row], self._velocity[row] = axes[4 * k], axes[4 * k + 1]
            self._effort[row] = axes[4 * k + 2]
            self._stamp[row] = now
        self._pass_time(unit, int(axes[11]))
        if unit.status & _ENABLED and not status & _ENABLED:
            unit.identified = False
        unit.status = status
        self._judge(unit, 0.1 * max(axes[8], axes[9]), 0.01 * axes[10], self._others(unit))
        return True

    def _pass_time(self, unit: _Controller, clock: int) -> None:
        """Process a controller's clock [µs]: the first response to a SYNC sets ``elapsed`` for all."""
        if self._now is None:
            step = 0 if unit.clock is None else (clock - unit.clock) & 0xFFFFFFFF
            self._now = self.elapsed if unit.clock is None else unit.elapsed
            if step < LONGEST_STEP:
                self._now += 1000 * step
        unit.clock, unit.elapsed = clock, self._now

    def _others(self, unit: _Controller) -> tuple[UnitFault, ...]:
        if unit.status & _ENABLED and not unit.jumped and not unit.status & _ANY_FAULT:
            return ()
        name, others = unit.record.unit, []
        if unit.jumped:
            joints = ", ".join(self._names[row] for row in unit.jumped)
            others.append(
                UnitFault(name, Fault.ENCODER, f"the encoder of {joints} jumped; to be calibrated, then restarted")
            )
        if self._enabled and not unit.status & _ENABLED:
            others.append(UnitFault(name, Fault.DISABLED, "its motors are off: it had lost its power"))
        others += [UnitFault(name, Fault.FAULTY, text) for flag, text in _FAULTS.items() if unit.status & flag]
        return tuple(others)

    def _provide(self) -> None:
        self.joint_state = JointMeasurement(
            np.array(self._stamp), self._encoder - self._offset, np.array(self._velocity), np.array(self._effort)
        )

    def _send_command(self) -> None:
        command = self.command
        if command is None or command is self._sent:
            return
        assert self._bus is not None
        self._sent = command
        slots = self._slots
        self._commands["sequence"] = command.sequence & 0xFFFF
        self._mode[slots] = command.mode
        self._axis["position"][slots] = command.position + self._offset
        for field in ("velocity", "effort", "stiffness", "damping"):
            self._axis[field][slots] = getattr(command, field)
        for unit in self._controllers.values():
            if unit.jumped:
                self._hold_by_encoder(unit)
        self._bus.send(can_frames.command_frames(tuple(self._controllers), self._commands))

    def _hold_by_encoder(self, unit: _Controller) -> None:
        """Hold joints whose encoder has jumped, at the encoder's value, which the controller's servo uses."""
        for row in unit.jumped:
            slot = self._slots[0][row], self._slots[1][row]
            if self._mode[slot] != JointMode.OFF:
                self._mode[slot] = JointMode.POSITION
                self._axis["position"][slot] = self._raw[row]
                self._axis["velocity"][slot] = self._axis["effort"][slot] = 0.0

    def _attend(self) -> None:
        """Identify controllers that lost power, and switch them on if that moves nothing."""
        if not self._enabled:
            return
        assert self._bus is not None
        for unit in self._controllers.values():
            if unit.status & _ENABLED or unit.missed:
                continue
            reply = self._replies.pop(unit.number, None)
            if reply is not None and reply.code == Code.IDENTIFY and reply.identity == unit.identity:
                unit.identified = True
            if not unit.identified:
                self._bus.send([can_frames.request(unit.number, Code.IDENTIFY)])
            elif self._may_enable(unit.rows):
                self._bus.send([can_frames.request(unit.number, code) for code in (Code.CALIBRATED, Code.ENABLE)])

    def _may_enable(self, rows: Sequence[int]) -> bool:
        """Return whether switching on moves nothing: set-points near the joints, or damping only."""
        command = self.command
        if command is None:
            return False
        position: FloatArray = self._encoder - self._offset
        return all(
            command.mode[row] == JointMode.OFF
            or (
                command.effort[row] == command.stiffness[row] == 0.0
                if command.mode[row] == JointMode.FORCE
                else abs(command.position[row] - position[row]) < ENABLE_WITHIN
            )
            for row in rows
        )
