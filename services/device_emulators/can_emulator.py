"""What the emulated devices on CAN buses have in common: who they are, and when they answer."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import can

from valor.common.instance import Settings
from valor.device_emulators.emulator import EmulatedFault, Emulator, FaultSwitches
from valor.device_emulators.faulty_line import FaultyLine
from valor.device_emulators.robot import SimulatedRobot
from valor.devices import can_frames
from valor.devices.can_frames import Code, Identity
from valor.devices.ports import open_can
from valor.devices.table import MotorController, WrenchSensor


class CanEmulator(Emulator):
    """Units on one bus. Each samples and answers when SYNC comes."""

    def __init__(
        self,
        name: str,
        settings: Settings,
        bus: int,
        units: Sequence[MotorController | WrenchSensor],
        kinds: frozenset[EmulatedFault] = frozenset(EmulatedFault),
    ) -> None:
        """``units``: those on the bus, named by their numbers; ``kinds``: of faults that they can have."""
        self._identities = {unit.id: Identity(unit.serial, unit.firmware) for unit in units}
        self._names = {unit.id: str(unit.id) for unit in units}
        super().__init__(name, FaultSwitches(tuple(self._names.values()), kinds))
        self._bus = open_can(settings, bus, can_frames.TO_UNITS, can_frames.KIND)
        self._line = FaultyLine(self._bus.send, self.faults, lambda frame: bytes(frame.data), _with_data)
        self._dead: set[int] = set()

    def files(self) -> tuple[int, ...]:
        """The bus' socket."""
        return (self._bus.fileno(),)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()

    def step(self, now: float, robot: SimulatedRobot) -> None:
        """Read the bus, obey, and answer."""
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
            self._hear(message, now, robot)
        self._pass_time(now, robot)
        self._line.flush(now)

    def _hear(self, message: can.Message, now: float, robot: SimulatedRobot) -> None:
        identifier = message.arbitration_id
        if identifier == can_frames.SYNC:
            counter = can_frames.read_small(message)
            if counter is not None:
                units = [unit for unit in self._identities if unit not in self._dead]
                # All at once: whoever gathers them wakes up for the first, and finds the others there.
                for unit, state in [(unit, self._state(unit, counter, now, robot)) for unit in units]:
                    self._line.send(self._names[unit], can_frames.frame(can_frames.STATE + unit, state), now)
            return
        unit = identifier & can_frames.UNIT
        if unit not in self._identities or unit in self._dead:
            return
        kind = identifier & can_frames.KIND
        if kind == can_frames.REQUEST:
            code = can_frames.read_small(message)
            if code is not None:
                done = code == Code.IDENTIFY or self._obey(unit, code, now, robot)
                if not self.faults.active(self._names[unit], EmulatedFault.SILENT, now):
                    self._bus.send(can_frames.reply(unit, code, done, self._identities[unit]))
        elif kind == can_frames.COMMAND:
            self._command(unit, message, now, robot)

    @abstractmethod
    def _state(self, unit: int, counter: int, now: float, robot: SimulatedRobot) -> bytes:
        """What a unit says of itself now: the data of its STATE frame."""

    @abstractmethod
    def _power_changed(self, unit: int, on: bool, robot: SimulatedRobot) -> None:
        """A unit has lost its supply, or got it back."""

    def _obey(self, unit: int, code: int, now: float, robot: SimulatedRobot) -> bool:
        """Do as a request other than for identity says; returns whether that was possible."""
        return False

    def _command(self, unit: int, message: can.Message, now: float, robot: SimulatedRobot) -> None:
        """Obey a COMMAND; sensors have no use for it."""

    def _pass_time(self, now: float, robot: SimulatedRobot) -> None:
        """What happens without anything being heard."""


def _with_data(frame: can.Message, data: bytes) -> can.Message:
    return can_frames.frame(frame.arbitration_id, data)
