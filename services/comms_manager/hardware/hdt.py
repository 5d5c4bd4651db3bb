"""The HDT arms and hands, over Bifrost and a bridge to ROS topics of the vendor's driver (thesis 3.4.3).

Bridge and driver may restart at any time. Joints that are back receive their measured position as first set-point,
which then moves to Motor's position at a bounded speed (``Rejoining``).
"""

import math
import time
from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

import bifrost
from valor.common import topics
from valor.common.arrays import FloatArray
from valor.common.messages import HdtCommand, HdtState, JointMode
from valor.common.topics import hdt_topics
from valor.comms_manager.hardware.device import (
    Device,
    DeviceContext,
    DeviceError,
    Fault,
    JointCommands,
    JointMeasurement,
    UnitFault,
    UnitRecord,
)
from valor.devices.hdt_bus import Fault as ModuleFault
from valor.devices.table import HdtBifrost, HdtLimb

FINDING = 30.0  # timeout of the first states of all limbs, at start [s]
ANSWERING = 5.0  # timeout of the first applied command, at start [s]
SILENCE = 0.2  # timeout of a limb's states [s]
_LOOK_EVERY = 0.02  # period of checking for timeouts and for the end [s]
# As numbers, which NumPy keeps in the type of its arrays.
_NO_ANSWER, _ENCODER = int(ModuleFault.NO_ANSWER), int(ModuleFault.ENCODER)
_HOT, _LOW = int(ModuleFault.OVER_TEMPERATURE), int(ModuleFault.UNDER_VOLTAGE)
_UNREACHABLE = _NO_ANSWER | _ENCODER
_STORED = 64  # commands stored to compute their latency
SPEED = 0.5  # of a joint that is back, towards Motor's position [rad/s]
_ARRIVED = 1e-3  # distance at which it follows Motor again [rad]


class Rejoining:
    """Set-points of k joints; joints that were unreachable move from their measured to the desired position."""

    def __init__(self, count: int) -> None:
        self.position = np.zeros(count)  # (k,) set-points of the last cycle [rad]
        self.out = np.ones(count, dtype=bool)  # (k,) joints that cannot be reached
        self.returning = np.zeros(count, dtype=bool)  # (k,) joints that move to the desired position

    def measured(self, measured: FloatArray, reachable: npt.NDArray[np.bool_]) -> None:
        """Process measured positions [rad] of reachable joints; those that were out start from there."""
        back = self.out & reachable
        if back.any():
            self.position[back] = measured[back]
            self.returning |= back
        self.out = ~reachable
        self.returning &= reachable

    def lost(self) -> None:
        self.out[:] = True
        self.returning[:] = False

    def advance(self, target: FloatArray, period: float) -> FloatArray:
        """(k,) set-points after ``period`` [s], toward the target [rad]; the last ones for joints that are out."""
        step = np.clip(target - self.position, -SPEED * period, SPEED * period)
        self.position = np.where(self.returning, self.position + step, np.where(self.out, self.position, target))
        self.returning &= np.abs(target - self.position) > _ARRIVED
        return self.position.copy()


class _Limb:
    def __init__(self, node: bifrost.Node, table: HdtLimb, joints: tuple[str, ...], part: slice, rate: float) -> None:
        self.name, self.joints, self.part = table.group, joints, part
        self.every = table.every
        self.period = table.every / rate
        commands, states = hdt_topics(table.group)
        self.commands, self.states = commands.publisher(node), states.subscriber(node)
        self.record = UnitRecord(table.group)
        self.rejoining = Rejoining(len(joints))
        self.state: HdtState | None = None
        # Greater than every sequence of an earlier run, regardless of the wall clock: states for those are detected.
        self.sequence = time.monotonic_ns() // 1000
        self.sent: OrderedDict[int, float] = OrderedDict()  # sequence → when [monotonic s]
        self.answered = False
        self.silent = True
        self.unit_faults: tuple[UnitFault, ...] = ()


class Hdt(Device):
    """Limbs behind the bridge, one unit each, at their own rate: each cycle sends the latest command."""

    silent_after = SILENCE

    def __init__(self, name: str, context: DeviceContext) -> None:
        super().__init__(name, context)
        table = context.robot.tables.devices[name]
        assert isinstance(table, HdtBifrost)
        self._table = table
        instance, robot = context.instance, context.robot
        self._node = bifrost.Node("comms_manager", network=topics.network(instance, "comms_manager"))
        self._limbs: list[_Limb] = []
        for limb in table.limbs:
            first = self._limbs[-1].part.stop if self._limbs else 0
            joints = tuple(robot.tables.group(limb.group))
            self._limbs.append(_Limb(self._node, limb, joints, slice(first, first + len(joints)), table.rate))
        self.records = tuple(limb.record for limb in self._limbs)
        self.rate = table.rate / max(limb.every for limb in table.limbs)
        m = len(self.joints)
        self._lower, self._upper = robot.lower[self.joints], robot.upper[self.joints]
        offsets = robot.tables.calibration.offsets
        self._offset = np.array([offsets.get(robot.joints[i], 0.0) for i in self.joints])
        self._stamp = np.zeros(m, dtype=np.int64)
        self._position, self._velocity, self._effort = np.zeros(m), np.zeros(m), np.zeros(m)
        self._cycle = 0
        self._due = -math.inf  # of the next cycle [monotonic s]; before the first, limbs may have moved since ``find``
        self._incoming = bifrost.Poller([limb.states for limb in self._limbs])

    def find(self) -> None:
        """Wait until every joint has been measured; the driver checks the limbs' identities."""
        deadline = time.monotonic() + FINDING
        while any((missing := self._missing(limb)) for limb in self._limbs):
            if time.monotonic() > deadline:
                raise DeviceError(missing)
            self._wait(_LOOK_EVERY)

    def enable(self) -> None:
        """Command the limbs to hold, and wait until they apply it."""
        deadline = time.monotonic() + ANSWERING
        while waiting := [limb for limb in self._limbs if not limb.answered]:
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"{self.name}/{waiting[0].name}: no command was applied within {ANSWERING:g} s; "
                    "expected hdt_driver to apply the command to hold"
                )
            for limb in waiting:
                self._send(limb, None)
            until = time.monotonic() + 1.0 / self._table.rate
            while (remaining := until - time.monotonic()) > 0.0:
                self._wait(remaining)

    def close(self) -> None:
        self._incoming.close()
        self._node.close()

    def _missing(self, limb: _Limb) -> str:
        """What is missing of a limb's state; an empty string if nothing."""
        unit, state = f"{self.name}/{limb.name}", limb.state
        if state is None:
            return f"{unit}: no state within {FINDING:g} s; {_silent(limb)}"
        for joint, fault in zip(limb.joints, state.fault.tolist(), strict=True):
            if fault & _UNREACHABLE:
                why = "module does not respond" if fault & _NO_ANSWER else "encoder has jumped"
                return f"{unit}: {joint}: its {why}; expected all modules"
        return ""

    def gather(self) -> None:
        now = time.monotonic()
        if self._due < 0.0:
            for limb in self._limbs:
                limb.rejoining.lost()
                limb.silent = True
        if now >= self._due:
            self._due = max(self._due + 1.0 / self._table.rate, now)
            self._cycle += 1
            for limb in self._limbs:
                # A limb that is back receives no command before its first state.
                if self._cycle % limb.every == 0 and not limb.silent:
                    self._send(limb, self.command)
        self._receive(self._incoming.look())  # messages received while this process was not scheduled prevent a timeout
        self._check_timeouts(now)

    def _wait(self, timeout: float) -> None:
        states = [limb.states for limb in self._limbs]
        self._receive(bifrost.wait(states, timeout))

    def _receive(self, ready: Sequence[bifrost.Subscriber[HdtState]]) -> None:
        valid = [
            self._process(limb, received.message)
            for limb in self._limbs
            if limb.states in ready and (received := limb.states.latest()) is not None
        ]
        if any(valid):
            self._provide()
        self.looks += 1

    def _provide(self) -> None:
        self.joint_state = JointMeasurement(
            self._stamp.copy(), self._position.copy(), self._velocity.copy(), self._effort.copy()
        )

    def _process(self, limb: _Limb, state: HdtState) -> bool:
        k, record = len(limb.joints), limb.record
        numbers = (state.position, state.velocity, state.effort, state.temperature)
        if state.fault.size != k or any(each.size != k for each in numbers):
            record.errors += 1
            return False
        reachable = (state.fault & _UNREACHABLE) == 0
        squares = sum(float(each[reachable].dot(each[reachable])) for each in numbers[:3])
        if not math.isfinite(squares):
            record.errors += 1
            return False
        now = time.monotonic_ns()
        record.received(now)
        if (sent := limb.sent.pop(state.command_sequence, None)) is not None:
            record.answered(1e-9 * now - sent)
            limb.answered = True
        record.temperature, record.voltage = float(np.max(state.temperature)), state.voltage
        part = limb.part
        measured = state.position - self._offset[part]
        self._stamp[part] = np.where(reachable, now, self._stamp[part])
        self._position[part] = np.where(reachable, measured, self._position[part])
        self._velocity[part] = np.where(reachable, state.velocity, 0.0)
        self._effort[part] = np.where(reachable, state.effort, 0.0)
        limb.rejoining.measured(measured, reachable)
        limb.state, limb.silent = state, False
        self._judge(limb, state)
        return True

    def _send(self, limb: _Limb, command: JointCommands | None) -> None:
        """Send the next set-points to a limb; without a command, to hold on its own servo."""
        part, k = limb.part, len(limb.joints)
        if command is None:
            target, zero = limb.rejoining.position, np.zeros(k)
            mode = np.full(k, JointMode.POSITION, dtype=np.uint8)
            velocity, effort, stiffness, damping = zero, zero, zero, zero
        else:
            mode, target = command.mode[part], command.position[part]
            velocity = np.where(limb.rejoining.returning | limb.rejoining.out, 0.0, command.velocity[part])
            effort, stiffness, damping = command.effort[part], command.stiffness[part], command.damping[part]
        target = np.minimum(np.maximum(target, self._lower[part]), self._upper[part])
        position = limb.rejoining.advance(target, limb.period) + self._offset[part]
        limb.sequence += 1
        limb.sent[limb.sequence] = time.monotonic()
        if len(limb.sent) > _STORED:
            limb.sent.popitem(last=False)
        now, motor = time.monotonic_ns(), command.sequence if command else 0
        limb.commands.publish(
            HdtCommand(now, limb.sequence, motor, mode, position, velocity, effort, stiffness, damping)
        )

    def _check_timeouts(self, now: float) -> None:
        for limb in self._limbs:
            if now - 1e-9 * limb.record.stamp <= SILENCE:
                continue
            if not limb.silent:
                limb.silent = True
                limb.rejoining.lost()
                self._velocity[limb.part] = self._effort[limb.part] = 0.0
                self._provide()
            self._set_faults(limb, (UnitFault(limb.name, Fault.SILENT, _silent(limb)),))

    def _judge(self, limb: _Limb, state: HdtState) -> None:
        found: list[UnitFault] = []
        faults = state.fault
        if faults.any():
            silent = faults & _NO_ANSWER > 0
            if silent.all():
                found.append(UnitFault(limb.name, Fault.UNPLUGGED, "none of its modules responds"))
            elif silent.any():
                found.append(UnitFault(limb.name, Fault.FAULTY, f"{_names(limb, silent)}: no response"))
            if (jumped := faults & _ENCODER > 0).any():
                found.append(UnitFault(limb.name, Fault.ENCODER, f"{_names(limb, jumped)}: encoder jumped"))
            supply = self.context.robot.tables.supply
            if (hot := faults & _HOT > 0).any():
                fault = Fault.HOT if float(state.temperature[hot].max()) >= supply.hot else Fault.WARM
                found.append(UnitFault(limb.name, fault, f"{_names(limb, hot)}: reports over-temperature"))
            if (faults & _LOW > 0).any():
                fault = Fault.FLAT if state.voltage <= supply.flat else Fault.LOW_VOLTAGE
                found.append(UnitFault(limb.name, fault, "reports under-voltage"))
        self._set_faults(limb, tuple(found))

    def _set_faults(self, limb: _Limb, unit_faults: tuple[UnitFault, ...]) -> None:
        if unit_faults != limb.unit_faults:
            limb.unit_faults = unit_faults
            self.report_faults([each for limb in self._limbs for each in limb.unit_faults])


def _silent(limb: _Limb) -> str:
    return "hdt_driver does not publish" if limb.states.publishers else "hdt_bridge is not running"


def _names(limb: _Limb, which: np.ndarray) -> str:
    return ", ".join(joint for joint, chosen in zip(limb.joints, which, strict=True) if chosen)
