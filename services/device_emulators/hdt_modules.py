"""The HDT modules at the far end of their driver's CAN FD bus."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import can
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.instance import Instance, Settings
from valor.common.messages import JointMode
from valor.device_emulators.emulator import EmulatedFault, Emulator, FaultSwitches, NoSuchFaultError
from valor.device_emulators.faulty_line import FaultyLine
from valor.device_emulators.robot import Places, SimulatedRobot
from valor.devices import hdt_bus
from valor.devices.hdt_bus import Fault, SegmentState, Setpoints
from valor.devices.ports import open_can
from valor.devices.table import HdtBifrost
from valor.robot.description import RobotDescription
from valor.simulation.gears import Gears

SUPPLY = 48.0  # [V]
_AMBIENT, _HEATING, _WARMING = 25.0, 0.05, 60.0  # [°C], [°C/(N·m)²], time constant of it [s]
_HOT, _LOW = 90.0, 40.0  # of a fault [°C], [V]
_JUMP = 0.5  # [rad]
_GARBAGE = 7  # bytes, which are no state
# CAN controllers throw frames with a wrong checksum away themselves: their unit is silent.
_KINDS = frozenset(EmulatedFault) - {EmulatedFault.BAD_CHECKSUM}
_MODULE_KINDS = frozenset({EmulatedFault.SILENT, EmulatedFault.OVER_TEMPERATURE, EmulatedFault.ENCODER_JUMP})


class HdtSwitches(FaultSwitches):
    """Of limbs, and of their modules, which can fail in fewer ways."""

    def __init__(self, limbs: tuple[str, ...], modules: tuple[str, ...]) -> None:
        super().__init__((*limbs, *modules), _KINDS)
        self._modules = frozenset(modules)

    def inject(self, unit: str, fault: EmulatedFault, until: float = math.inf) -> None:
        """As of every device.

        Raises:
            NoSuchFaultError: no such unit, or it cannot fail so.
        """
        if unit in self._modules and fault not in _MODULE_KINDS:
            known = ", ".join(sorted(_MODULE_KINDS))
            raise NoSuchFaultError(f"fault {fault} of module {unit}: expected one of {known}")
        super().inject(unit, fault, until)


@dataclass
class _Segment:
    """A gateway and its modules.

    Attributes:
        limb: group that they belong to.
        joints: their places in every joint vector.
        names: of the joints.
        first: of its limb.
        line: on which it answers.
        setpoints: obeyed now; None: they hold where they were switched on.
        frame: count of the frame that brought them.
        heard: when that was [s].
        sequence: of the newest state.
        powered: whether it is plugged in.
        said: the newest state that it said.
        temperature: (k,) [°C].
    """

    limb: str
    joints: Places
    names: tuple[str, ...]
    first: bool
    line: FaultyLine[can.Message]
    temperature: FloatArray
    setpoints: Setpoints | None = None
    frame: int = 0
    heard: float = -math.inf
    sequence: int = 0
    powered: bool = False
    said: SegmentState | None = None
    warmed: float = field(default=math.nan)


class HdtModules(Emulator):
    """All arms and hands, their segments numbered as the driver numbers them.

    Units are the limbs, and each module by its joint's name. A module that is silent leaves its gateway's answer with
    what it said last, and the gateway says so of it. What a gear does is in the plant: the motors' encoders, which the
    modules report, are ahead of the joints by the play.
    """

    def __init__(self, name: str, instance: Instance, settings: Settings, robot: RobotDescription) -> None:
        """As ``kinds.Maker``."""
        del instance
        table, groups = robot.tables.devices[name], robot.tables.groups
        assert isinstance(table, HdtBifrost)
        modules = tuple(joint for limb in table.limbs for joint in groups[limb.group])
        super().__init__(name, HdtSwitches(tuple(limb.group for limb in table.limbs), modules))
        self._bus = open_can(settings, table.bus, (hdt_bus.COMMAND, hdt_bus.INQUIRY), hdt_bus.KIND)
        self._identity = {limb.group: (limb.serial, limb.firmware) for limb in table.limbs}
        self._play = Gears.of(robot, robot.tables.actuators[settings.actuators]).half_backlash
        self._segments: list[_Segment] = []
        for limb in table.limbs:
            places, joints = robot.group_indices(limb.group), groups[limb.group]
            for part in hdt_bus.segments(len(joints)):
                warm, first = np.full(part.stop - part.start, _AMBIENT), part.start == 0
                line = FaultyLine(self._bus.send, self.faults, lambda _: bytes(_GARBAGE), _with_data)
                self._segments.append(_Segment(limb.group, places[part], tuple(joints[part]), first, line, warm))

    def files(self) -> tuple[int, ...]:
        """The bus."""
        return (self._bus.fileno(),)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()

    def step(self, now: float, robot: SimulatedRobot) -> None:
        """Obey and answer."""
        for segment in self._segments:
            self._plug(segment, now, robot)
        while (frame := self._receive()) is not None:
            kind, number = hdt_bus.kind_and_segment(frame.arbitration_id)
            if number >= len(self._segments) or not self._segments[number].powered:
                continue
            segment = self._segments[number]
            if kind == hdt_bus.INQUIRY:
                if not self._fails(segment, EmulatedFault.SILENT, now):
                    self._bus.send(hdt_bus.identity(number, *self._identity[segment.limb]))
            elif kind == hdt_bus.COMMAND:
                self._obey(segment, frame, now, robot)
                self._answer(number, segment, now, robot)
        for segment in self._segments:
            if segment.setpoints is not None and now - segment.heard > hdt_bus.WATCHDOG:
                segment.heard = math.inf  # once
                zero = np.zeros(len(segment.joints))
                self._command(segment, replace(segment.setpoints, velocity=zero), robot)
        for segment in self._segments:
            segment.line.flush(now)

    def _receive(self) -> can.Message | None:
        while True:
            try:
                return self._bus.recv(0.0)
            except can.CanError:
                continue  # not a frame

    def _plug(self, segment: _Segment, now: float, robot: SimulatedRobot) -> None:
        powered = not self._fails(segment, EmulatedFault.UNPLUGGED, now)
        if powered == segment.powered:
            return
        segment.powered, segment.setpoints, segment.frame, segment.said = powered, None, 0, None
        robot.power(segment.joints, powered)
        if powered:
            robot.hold(segment.joints)

    def _obey(self, segment: _Segment, frame: can.Message, now: float, robot: SimulatedRobot) -> None:
        try:
            count, setpoints = hdt_bus.parse_command(frame, len(segment.joints))
        except hdt_bus.FrameError:
            return
        if setpoints is not None:
            segment.setpoints, segment.frame, segment.heard = setpoints, count, now
            self._command(segment, setpoints, robot)

    @staticmethod
    def _command(segment: _Segment, to: Setpoints, robot: SimulatedRobot) -> None:
        robot.command(
            segment.joints,
            mode=to.mode,
            position=to.position,
            velocity=to.velocity,
            effort=to.effort,
            stiffness=to.stiffness,
            damping=to.damping,
        )

    def _answer(self, number: int, segment: _Segment, now: float, robot: SimulatedRobot) -> None:
        segment.sequence = (segment.sequence + 1) & 0xFFFF
        state = self._measure(segment, now, robot)
        segment.line.send(segment.limb, hdt_bus.state(number, state), now)

    def _measure(self, segment: _Segment, now: float, robot: SimulatedRobot) -> SegmentState:
        joints, measured = segment.joints, robot.measured
        position = measured.joint_position[joints]
        if segment.setpoints is not None:
            ahead = segment.setpoints.position - position
            driven = (segment.setpoints.mode == JointMode.POSITION) | (segment.setpoints.mode == JointMode.IMPEDANCE)
            play = self._play[joints] * driven
            position = position + np.minimum(np.maximum(ahead, -play), play)
        effort = measured.joint_effort[joints]
        passed = 0.0 if math.isnan(segment.warmed) else now - segment.warmed
        segment.warmed = now
        segment.temperature += min(1.0, passed / _WARMING) * (_AMBIENT + _HEATING * effort**2 - segment.temperature)
        state = SegmentState(
            segment.frame,
            segment.sequence,
            SUPPLY,
            position,
            measured.joint_velocity[joints],
            effort,
            segment.temperature.copy(),
            np.zeros(len(joints), dtype=np.uint8),
        )
        state = self._with_faults(segment, state, now)
        segment.said = state
        return state

    def _with_faults(self, segment: _Segment, state: SegmentState, now: float) -> SegmentState:
        """The state as it is said while modules fail."""
        active, said = self.faults.active, segment.said
        for i, unit in enumerate(segment.names):
            if active(unit, EmulatedFault.SILENT, now):
                state.fault[i] |= int(Fault.NO_ANSWER)
                for name in ("position", "velocity", "effort"):
                    getattr(state, name)[i] = getattr(said, name)[i] if said is not None else 0.0
            if any(active(each, EmulatedFault.OVER_TEMPERATURE, now) for each in (segment.limb, unit)):
                state.temperature[i] = _HOT
                state.fault[i] |= int(Fault.OVER_TEMPERATURE)
            if active(unit, EmulatedFault.ENCODER_JUMP, now):
                state.position[i] += _JUMP
        if segment.first and active(segment.limb, EmulatedFault.ENCODER_JUMP, now):
            state.position[0] += _JUMP
        if self._fails(segment, EmulatedFault.UNDER_VOLTAGE, now):
            state.fault[:] |= int(Fault.UNDER_VOLTAGE)
            return replace(state, voltage=_LOW)
        return state

    def _fails(self, segment: _Segment, fault: EmulatedFault, now: float) -> bool:
        return self.faults.active(segment.limb, fault, now)


def _with_data(frame: can.Message, data: bytes) -> can.Message:
    return can.Message(
        arbitration_id=frame.arbitration_id, data=data, is_extended_id=False, is_fd=True, bitrate_switch=True
    )
