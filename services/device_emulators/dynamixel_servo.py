"""One Dynamixel servo at the far end of its bus: its control table, and what its firmware makes of it.

From the public e-manual: what can be written and when, what a number out of range is answered, when a servo switches
its torque off by itself.
"""

from __future__ import annotations

from enum import IntEnum

from valor.devices.dynamixel import DEFAULT_SHUTDOWN, HardwareError, Item, OperatingMode, ServoModel


class Error(IntEnum):
    """Why a servo does not do it; bit 7 of a status says that ``hardware_error`` is not 0."""

    NONE = 0
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    ACCESS = 7
    ALERT = 0x80


class Servo:
    """One servo: its control table, written by the driver; its present values, written by what feels the joint.

    Attributes:
        temperature: of the motor [°C].
        voltage: of the supply [V].
    """

    def __init__(self, servo_id: int, model: ServoModel, firmware: int) -> None:
        self.id = servo_id
        self.model = model
        table = model.table
        self._registers = bytearray(table.size)
        self.set(table.model_number, model.number)
        self.set(table.firmware, firmware)
        self.set(table.id, servo_id)
        self.set(table.operating_mode, OperatingMode.POSITION)
        self.set(table.temperature_limit, model.temperature_limit)
        self.set(table.max_voltage, round(13.3 * model.voltage))
        self.set(table.min_voltage, round(7.9 * model.voltage))
        self.set(table.shutdown, int(DEFAULT_SHUTDOWN))
        self.temperature = 32.0
        self.voltage = model.voltage

    # --- the control table -------------------------------------------------------------------------------------------

    def get(self, item: Item) -> int:
        """A number of the control table."""
        return int.from_bytes(self._registers[item.address : item.address + item.size], "little", signed=item.signed)

    def set(self, item: Item, value: int) -> None:
        """Write a number as the servo's own firmware does, whatever the driver may write."""
        bits = 8 * item.size
        self._registers[item.address : item.address + item.size] = (value & ((1 << bits) - 1)).to_bytes(
            item.size, "little"
        )

    def read(self, address: int, size: int) -> bytes | None:
        """Bytes of the table; None if there are none at that place."""
        if size < 1 or address + size > len(self._registers):
            return None
        return bytes(self._registers[address : address + size])

    def write(self, address: int, data: bytes) -> Error:
        """Obey a write of the driver."""
        table = self.model.table
        writable = (table.torque_enable, table.goal_velocity, table.goal_position)
        persistent = (
            table.operating_mode,
            table.temperature_limit,
            table.shutdown,
            table.min_voltage,
            table.max_voltage,
        )
        for item in (*writable, *persistent):
            if (item.address, item.size) == (address, len(data)):
                break
        else:
            return Error.ACCESS
        if item in persistent and self.torque:
            return Error.ACCESS
        value = int.from_bytes(data, "little", signed=item.signed)
        if item == table.torque_enable:
            if value not in (0, 1):
                return Error.DATA_RANGE
            if value and self.get(table.hardware_error) & self.get(table.shutdown):
                return Error.ACCESS
            if value and not self.torque:  # a servo that is switched on stays where it is
                self.set(table.goal_position, self.get(table.present_position))
                self.set(table.goal_velocity, 0)
        if item == table.operating_mode and value not in tuple(OperatingMode):
            return Error.DATA_RANGE
        lowest, highest = self.model.goals
        if item == table.goal_position and self.mode == OperatingMode.POSITION and not lowest <= value <= highest:
            return Error.DATA_RANGE
        self.set(item, value)
        return Error.NONE

    def reboot(self) -> None:
        """Start anew: torque off, errors forgotten until they are found again."""
        table = self.model.table
        for item in (table.torque_enable, table.hardware_error, table.goal_velocity):
            self.set(item, 0)

    # --- the joint ---------------------------------------------------------------------------------------------------

    @property
    def torque(self) -> bool:
        """Whether the motor is on."""
        return bool(self.get(self.model.table.torque_enable))

    @property
    def mode(self) -> int:
        """OperatingMode."""
        return self.get(self.model.table.operating_mode)

    @property
    def goal_position(self) -> int:
        """[steps]."""
        return self.get(self.model.table.goal_position)

    @property
    def goal_velocity(self) -> float:
        """[rad/s]."""
        return self.get(self.model.table.goal_velocity) * self.model.velocity_unit

    def feel(self, position: float, velocity: float, torque: float, now: float) -> None:
        """Measure: steps from the encoder's own zero, [rad/s], [N·m], at ``now`` [s]; check temperature and voltage."""
        model, table = self.model, self.model.table
        self.set(table.realtime_tick, int(now * 1e3) % 32768)
        self.set(table.present_position, round(position))
        self.set(table.present_velocity, round(velocity / model.velocity_unit))
        self.set(table.present_current, round(torque / model.torque_constant / model.current_unit))
        self.set(table.present_voltage, round(10 * self.voltage))
        self.set(table.present_temperature, min(255, round(self.temperature)))
        wrong = HardwareError(0)
        if self.temperature >= self.get(table.temperature_limit):
            wrong |= HardwareError.OVERHEATING
        if not self.get(table.min_voltage) <= 10 * self.voltage <= self.get(table.max_voltage):
            wrong |= HardwareError.INPUT_VOLTAGE
        if wrong:
            self.set(table.hardware_error, self.get(table.hardware_error) | wrong)
            if wrong & self.get(table.shutdown):
                self.set(table.torque_enable, 0)

    @property
    def alert(self) -> int:
        """Error.ALERT if something is wrong with the hardware."""
        return int(Error.ALERT) if self.get(self.model.table.hardware_error) else 0
