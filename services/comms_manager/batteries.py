"""Charge of the batteries, estimated from the supply's voltage and the joints: the packs themselves report nothing.

At first the charge is that of the voltage, without the drop of the current; then the current is counted, and the charge
drawn towards the voltage's.
"""

import math

import bifrost
from valor.common.messages import BatteryStatus, Proprioceptor
from valor.common.topics import BATTERIES
from valor.comms_manager.hardware.condition import level
from valor.comms_manager.hardware.device import Fault, Part, UnitFault, UnitRecord, Watched
from valor.robot.batteries import LOWEST, Batteries
from valor.robot.description import RobotDescription
from valor.service import Context

NAME = "batteries"
EVERY = 20_000_000  # period of counting [ns]
PERIOD = 1_000_000_000  # of reports [ns]
TIME_CONSTANT = 300.0  # in which an error of the charge decreases by a factor of e, if that of the voltage is right [s]
MORE = 0.02  # hysteresis of the share of charge


class BatteryMonitor(Watched):
    """Estimator and monitor of the charge; the main loop calls ``update``."""

    def __init__(self, robot: RobotDescription, table: Batteries, node: bifrost.Node) -> None:
        super().__init__(NAME, 0.0, (UnitRecord(NAME),))  # never slow: its states are the control periods
        self._table, self._limit = table, robot.effort_limit
        self._publisher = BATTERIES.publisher(node)
        self._share = math.nan  # of charge
        self._time = self._due = 0  # robot time [ns]
        self._level = 0  # number of limits that the charge is below

    @classmethod
    def of(cls, context: Context) -> "list[BatteryMonitor]":
        """The robot's, if it has some."""
        table = context.robot.tables.batteries
        return [cls(context.robot, table, context.node)] if table else []

    def part(self, unit: str) -> Part:
        return Part.BATTERY

    @property
    def note(self) -> str:
        """Its fault in one line; empty without one."""
        return f"{NAME}: {self.unit_faults[0].detail}" if self.unit_faults else ""

    def update(self, state: Proprioceptor) -> None:
        """Process the measurements of a control period, in most of which nothing is due."""
        if 0 < state.time - self._time < EVERY:
            return
        table, voltage, record = self._table, state.battery_voltage, self.records[0]
        current = table.power(state.joint_effort, state.joint_velocity, self._limit) / max(voltage, 1.0)
        by_voltage = table.share(voltage, current)
        if math.isnan(self._share):
            self._share, self._time = by_voltage, state.time
        elapsed, self._time = 1e-9 * (state.time - self._time), state.time
        counted = self._share - current * elapsed / 3600.0 / table.whole
        self._share = min(1.0, max(0.0, counted + (by_voltage - counted) * min(1.0, elapsed / TIME_CONSTANT)))
        record.states, record.voltage, self.looks = record.states + 1, voltage, self.looks + 1
        if state.time >= self._due:
            self._due = state.time + PERIOD
            self._judge(voltage / table.series)
            self._publisher.publish(BatteryStatus(state.time, voltage, current, self._share * table.whole))

    def _judge(self, cell: float) -> None:
        table = self._table
        charge = self._share if cell >= LOWEST else 0.0
        before, self._level = self._level, level(-charge, (-table.low, -table.critical), self._level, MORE)
        if not self._level:
            self.report_faults([])
        elif self._level != before:
            fault, limit = ((Fault.LOW_VOLTAGE, table.low), (Fault.FLAT, table.critical))[self._level - 1]
            text = (
                f"charge {self._share:.0%}, {cell:.2f} V a cell; expected more than {limit:.0%}: charge or change them"
            )
            self.report_faults([UnitFault(NAME, fault, text)])
