"""The HDT arms and hands: over Bifrost to a bridge that makes ROS topics of it for the vendor's driver (3.4.3).

Neither the bridge nor the driver is trusted to live: each may end and begin anew at any time. Whoever is back is found
where it is: the first set-point is the measured position, and from there the joints go to what Motor asks at a bounded
speed (``rejoin.py``).
"""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from threading import Event

import numpy as np

import bifrost
from valor.common import membership
from valor.common.messages import HdtCommand, HdtState, JointMode
from valor.common.topics import hdt_topics
from valor.comms_manager.hardware.device import (
    Ailment,
    Device,
    DeviceContext,
    DeviceError,
    Fault,
    JointCommands,
    JointMeasurement,
    UnitRecord,
)
from valor.comms_manager.hardware.rejoin import Rejoining
from valor.devices.hdt_bus import Fault as ModuleFault
from valor.devices.table import HdtBifrost, HdtLimb

FINDING = 30.0  # within which all limbs must have said where they are [s]
ANSWERING = 5.0  # within which a command must have acted [s]
SILENCE = 0.2  # without a state, after which a limb is taken to be out of reach [s]
_LOOK_EVERY = 0.02  # at silence, and at whether to stop [s]
# As numbers, which NumPy keeps in the type of its arrays.
_NO_ANSWER, _ENCODER = int(ModuleFault.NO_ANSWER), int(ModuleFault.ENCODER)
_HOT, _LOW = int(ModuleFault.OVER_TEMPERATURE), int(ModuleFault.UNDER_VOLTAGE)
_UNREACHABLE = _NO_ANSWER | _ENCODER
_REMEMBERED = 64  # commands, for their latency


class _Limb:
    """One limb's topics, what it said last and what it is told."""

    def __init__(self, node: bifrost.Node, table: HdtLimb, joints: tuple[str, ...], part: slice, rate: float) -> None:
        self.name, self.joints, self.part = table.group, joints, part
        self.every = table.every
        self.period = table.every / rate
        commands, states = hdt_topics(table.group)
        self.commands, self.states = commands.publisher(node), states.subscriber(node)
        self.record = UnitRecord(table.group)
        self.rejoining = Rejoining(len(joints))
        self.state: HdtState | None = None
        # Greater than every sequence of an earlier run, whoever sets the clock: a state that answers one is known.
        self.sequence = time.monotonic_ns() // 1000
        self.sent: OrderedDict[int, float] = OrderedDict()  # sequence → when [monotonic s]
        self.answered = False
        self.silent = True
        self.ailments: tuple[Ailment, ...] = ()


class Hdt(Device):
    """Limbs behind the bridge; a unit each. It keeps a pace of its own: the newest command counts."""

    silent_after = SILENCE

    def __init__(self, name: str, context: DeviceContext) -> None:
        super().__init__(name, context)
        table = context.robot.tables.devices[name]
        assert isinstance(table, HdtBifrost)
        self._table = table
        instance, robot = context.instance, context.robot
        self._node = bifrost.Node("comms_manager", network=membership.network(instance, "comms_manager"))
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

    def wake(self) -> None:
        """Nobody waits for the main loop."""

    # --- start and end --------------------------------------------------------------------------------------------

    def find(self) -> None:
        """Wait until every joint of every limb has been measured. Who the limbs are, their driver has asked them."""
        deadline = time.monotonic() + FINDING
        while any((missing := self._missing(limb)) for limb in self._limbs):
            if time.monotonic() > deadline:
                raise DeviceError(missing)
            self._listen(_LOOK_EVERY)

    def enable(self) -> None:
        """Tell the limbs to stay where they are, and see that this acts."""
        deadline = time.monotonic() + ANSWERING
        while waiting := [limb for limb in self._limbs if not limb.answered]:
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"{self.name}/{waiting[0].name}: no command acted within {ANSWERING:g} s; "
                    "expected hdt_driver to obey what says: stay where you are"
                )
            for limb in waiting:
                self._tell(limb, None)
            until = time.monotonic() + 1.0 / self._table.rate
            while (remaining := until - time.monotonic()) > 0.0:
                self._listen(remaining)

    def close(self) -> None:
        """Leave Bifrost; the limbs hold by themselves."""
        self._node.close()
        super().close()

    def _missing(self, limb: _Limb) -> str:
        """What is not known of a limb; empty: nothing."""
        unit, state = f"{self.name}/{limb.name}", limb.state
        if state is None:
            who = "hdt_driver says nothing" if limb.states.publishers else "hdt_bridge is not there"
            return f"{unit}: no state within {FINDING:g} s; {who}"
        for joint, fault in zip(limb.joints, state.fault.tolist(), strict=True):
            if fault & _UNREACHABLE:
                why = "module does not answer" if fault & _NO_ANSWER else "encoder cannot be believed"
                return f"{unit}: {joint}: its {why}; expected all modules"
        return ""

    # --- the thread -----------------------------------------------------------------------------------------------

    def run(self, stopping: Event) -> None:
        """Exchange messages until told to stop."""
        for limb in self._limbs:  # meanwhile they may have moved
            limb.rejoining.lost()
            limb.silent = True
        period, due = 1.0 / self._table.rate, time.monotonic()
        while not stopping.is_set():
            now = time.monotonic()
            if now >= due:
                due = max(due + period, now)
                self._cycle += 1
                for limb in self._limbs:
                    # Whoever comes back hears nothing before he has said where he is.
                    if self._cycle % limb.every == 0 and not limb.silent:
                        self._tell(limb, self.command)
                self._listen(0.0)  # what has come while this thread waited for its turn is no silence
                self._look_for_silence(now)
            self._listen(min(_LOOK_EVERY, max(0.0, due - now)))

    def _listen(self, timeout: float) -> None:
        """Wait for states, and hand them over."""
        ready = bifrost.wait([limb.states for limb in self._limbs], timeout)
        news = False
        for limb in self._limbs:
            if limb.states in ready and (received := limb.states.latest()) is not None:
                news = self._hear(limb, received.message) or news
        if news:
            self._hand_over()
        self.looks += 1

    def _hand_over(self) -> None:
        self.joint_state = JointMeasurement(
            self._stamp.copy(), self._position.copy(), self._velocity.copy(), self._effort.copy()
        )

    def _hear(self, limb: _Limb, state: HdtState) -> bool:
        """Take a state in; returns whether it is sound."""
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
        limb.rejoining.heard(measured, reachable)
        limb.state, limb.silent = state, False
        self._judge(limb, state)
        return True

    def _tell(self, limb: _Limb, command: JointCommands | None) -> None:
        """Send a limb its next set-points; without a command, to stay where it is on its own servo."""
        part, k = limb.part, len(limb.joints)
        if command is None:
            wanted, zero = limb.rejoining.position, np.zeros(k)
            mode = np.full(k, JointMode.POSITION, dtype=np.uint8)
            velocity, effort, stiffness, damping = zero, zero, zero, zero
        else:
            mode, wanted = command.mode[part], command.position[part]
            velocity = np.where(limb.rejoining.returning | limb.rejoining.out, 0.0, command.velocity[part])
            effort, stiffness, damping = command.effort[part], command.stiffness[part], command.damping[part]
        wanted = np.minimum(np.maximum(wanted, self._lower[part]), self._upper[part])
        position = limb.rejoining.advance(wanted, limb.period) + self._offset[part]
        limb.sequence += 1
        limb.sent[limb.sequence] = time.monotonic()
        if len(limb.sent) > _REMEMBERED:
            limb.sent.popitem(last=False)
        limb.commands.publish(
            HdtCommand(
                time=time.monotonic_ns(),
                sequence=limb.sequence,
                motor_sequence=command.sequence if command else 0,
                mode=mode,
                position=position,
                velocity=velocity,
                effort=effort,
                stiffness=stiffness,
                damping=damping,
            )
        )

    def _look_for_silence(self, now: float) -> None:
        for limb in self._limbs:
            if now - 1e-9 * limb.record.stamp <= SILENCE:
                continue
            if not limb.silent:
                limb.silent = True
                limb.rejoining.lost()
                self._velocity[limb.part] = self._effort[limb.part] = 0.0
                self._hand_over()
            who = "hdt_driver says nothing" if limb.states.publishers else "hdt_bridge is not there"
            ailments = (Ailment(limb.name, Fault.SILENT, who),)
            if ailments != limb.ailments:
                limb.ailments = ailments
                self._tell_ailments()

    def _judge(self, limb: _Limb, state: HdtState) -> None:
        """What its modules say of themselves."""
        found: list[Ailment] = []
        faults = state.fault
        if faults.any():
            deaf = faults & _NO_ANSWER > 0
            if deaf.all():
                found.append(Ailment(limb.name, Fault.UNPLUGGED, "none of its modules answers"))
            elif deaf.any():
                found.append(Ailment(limb.name, Fault.FAULTY, f"{_names(limb, deaf)}: no answer"))
            if (jumped := faults & _ENCODER > 0).any():
                found.append(Ailment(limb.name, Fault.ENCODER, f"{_names(limb, jumped)}: its encoder jumped"))
            supply = self.context.robot.tables.supply
            if (hot := faults & _HOT > 0).any():
                fault = Fault.HOT if float(state.temperature[hot].max()) >= supply.hot else Fault.WARM
                found.append(Ailment(limb.name, fault, f"{_names(limb, hot)}: says that it is too hot"))
            if (faults & _LOW > 0).any():
                fault = Fault.FLAT if state.voltage <= supply.flat else Fault.LOW_VOLTAGE
                found.append(Ailment(limb.name, fault, "says that its supply is too low"))
        if tuple(found) != limb.ailments:
            limb.ailments = tuple(found)
            self._tell_ailments()

    def _tell_ailments(self) -> None:
        self.tell([ailment for limb in self._limbs for ailment in limb.ailments])


def _names(limb: _Limb, which: np.ndarray) -> str:
    return ", ".join(joint for joint, chosen in zip(limb.joints, which, strict=True) if chosen)
