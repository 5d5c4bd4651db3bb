"""Emulated HDT modules on the socket of their driver."""

import contextlib
import math
import socket
from dataclasses import dataclass

import numpy as np

from valor.common.instance import Instance, Settings
from valor.common.messages import JointMode
from valor.device_emulators.emulator import ALL_FAULTS, EmulatedFault, Emulator, FaultyLine
from valor.device_emulators.robot import Places, SimulatedRobot
from valor.devices import hdt_bus
from valor.devices.hdt_bus import Fault
from valor.devices.ports import serial_port
from valor.devices.table import HdtBifrost, HdtLimb
from valor.robot.description import RobotDescription
from valor.simulation.actuators import Gears

SUPPLY, WEAK_SUPPLY = 48.0, 40.0  # normal, and in the fault [V]
WARM, HOT = 30.0, 90.0  # likewise [°C]
JUMP = 0.5  # in the fault [rad]
_MODULE_KINDS = frozenset({EmulatedFault.SILENT, EmulatedFault.OVER_TEMPERATURE, EmulatedFault.ENCODER_JUMP})
# Datagrams have no checksum.
_KINDS = ALL_FAULTS - {EmulatedFault.BAD_CHECKSUM}


@dataclass
class _Limb:
    """Modules of one limb."""

    number: int  # on the bus
    table: HdtLimb
    joints: Places
    names: tuple[str, ...]  # of the joints
    command: np.void | None = None  # active set-points; None before the first since power-on
    received: float = -math.inf  # time of that command [s]
    powered: bool = False
    reported: np.ndarray | None = None  # latest state

    def __post_init__(self) -> None:
        self.commands, self.states = hdt_bus.command_layout(len(self.names)), hdt_bus.state_layout(len(self.names))


class HdtModules(Emulator):
    """All arms and hands. Units are the limbs, and the modules by their joints' names.

    For a silent module the limb repeats the last values with fault NO_ANSWER. The plant simulates the gears; the
    modules report motor encoders, which lead the joints by the gears' play.
    """

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        table, groups = robot.tables.devices[name], robot.tables.groups
        assert isinstance(table, HdtBifrost)
        self._limbs = [
            _Limb(number, limb, robot.group_indices(limb.group), tuple(groups[limb.group]))
            for number, limb in enumerate(table.limbs)
        ]
        modules = [joint for limb in self._limbs for joint in limb.names]
        limbs = [limb.group for limb in table.limbs]
        super().__init__(name, dict.fromkeys(limbs, _KINDS) | dict.fromkeys(modules, _MODULE_KINDS))
        self._path = serial_port(instance, settings, name)
        self._path.unlink(missing_ok=True)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.bind(str(self._path))
        self._driver: bytes = b""  # address of the latest command
        self._line = FaultyLine(self._send, self.faults)
        self._play = Gears.of(robot, robot.tables.actuators[settings.actuators]).half_backlash

    def files(self) -> tuple[int, ...]:
        return (self._socket.fileno(),)

    def close(self) -> None:
        self._socket.close()
        self._path.unlink(missing_ok=True)

    def step(self, now: float, robot: SimulatedRobot) -> None:
        for limb in self._limbs:
            self._plug(limb, now, robot)
        while data := self._receive():
            limb = self._limbs[data[0]]
            if not limb.powered:
                continue
            command = np.frombuffer(data, limb.commands)[0]
            if command["sequence"]:
                limb.command, limb.received = command, now
                _command(limb, command, command["velocity"], robot)
            state = self._measure(limb, int(command["frame"]), now, robot)
            self._line.send(limb.table.group, state.tobytes(), now)
        for limb in self._limbs:
            if limb.command is not None and now - limb.received > hdt_bus.WATCHDOG:
                limb.received = math.inf  # once
                _command(limb, limb.command, np.zeros(len(limb.joints)), robot)
        self._line.flush(now)

    def _receive(self) -> bytes:
        """A command; empty if there is none."""
        try:
            data, self._driver = self._socket.recvfrom(4096)
        except BlockingIOError:
            return b""
        return data

    def _send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):  # the driver has ended
            self._socket.sendto(data, self._driver)

    def _plug(self, limb: _Limb, now: float, robot: SimulatedRobot) -> None:
        powered = not self.faults.active(limb.table.group, EmulatedFault.UNPLUGGED, now)
        if powered == limb.powered:
            return
        limb.powered, limb.command, limb.reported = powered, None, None
        robot.power(limb.joints, powered)
        if powered:
            robot.hold(limb.joints)

    def _measure(self, limb: _Limb, frame: int, now: float, robot: SimulatedRobot) -> np.ndarray:
        joints, measured, command = limb.joints, robot.recent, limb.command
        state = np.zeros((), limb.states)
        state["limb"], state["frame"] = limb.number, frame
        state["serial"], state["firmware"] = limb.table.serial, limb.table.firmware
        state["voltage"], state["temperature"] = SUPPLY, WARM
        state["position"], state["effort"] = measured.joint_position[joints], measured.joint_effort[joints]
        state["velocity"] = measured.joint_velocity[joints]
        if command is not None:
            state["sequence"] = command["sequence"]
            driven = (command["mode"] == JointMode.POSITION) | (command["mode"] == JointMode.IMPEDANCE)
            play = self._play[joints] * driven
            ahead = command["position"] - state["position"]
            state["position"] += np.minimum(np.maximum(ahead, -play), play)
        if self.faults:
            self._add_faults(limb, state, now)
        limb.reported = state
        return state

    def _add_faults(self, limb: _Limb, state: np.ndarray, now: float) -> None:
        active, group = self.faults.active, limb.table.group
        for i, unit in enumerate(limb.names):
            if active(unit, EmulatedFault.SILENT, now):
                state["fault"][i] |= int(Fault.NO_ANSWER)
                for name in ("position", "velocity", "effort"):
                    state[name][i] = limb.reported[name][i] if limb.reported is not None else 0.0
            if any(active(each, EmulatedFault.OVER_TEMPERATURE, now) for each in (group, unit)):
                state["temperature"][i] = HOT
                state["fault"][i] |= int(Fault.OVER_TEMPERATURE)
            if active(unit, EmulatedFault.ENCODER_JUMP, now) or (
                i == 0 and active(group, EmulatedFault.ENCODER_JUMP, now)
            ):
                state["position"][i] += JUMP
        if active(group, EmulatedFault.UNDER_VOLTAGE, now):
            state["fault"] |= int(Fault.UNDER_VOLTAGE)
            state["voltage"] = WEAK_SUPPLY


def _command(limb: _Limb, to: np.void, velocity: np.ndarray, robot: SimulatedRobot) -> None:
    robot.command(limb.joints, to["mode"], {name: to[name] for name in hdt_bus.SETPOINTS} | {"velocity": velocity})
