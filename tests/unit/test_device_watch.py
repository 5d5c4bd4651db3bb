"""What the robot does about devices' faults: the table, who is named, and when it is over."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from harness.device_bench import StillDevice
from harness.places import ROBOTS
from valor.common.behaviors import BEHAVIOR_TRANSITIONS, Behavior, Reaction
from valor.common.messages import DeviceStatus
from valor.comms_manager.hardware.condition import level as _level
from valor.comms_manager.hardware.device import Fault, ImuMeasurement, Part, UnitFault
from valor.comms_manager.hardware.watch import DISAGREEMENT, LOOKS_TO_SILENCE, REACTIONS, UNREAD_AFTER, DeviceWatch
from valor.devices.kvh import Kvh1750
from valor.motion_manager.behavior_fsm import BehaviorFsm
from valor.motion_manager.safety import DEMANDS, DeviceReactions
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
PERIOD = 4_000_000  # [ns]


class Bench:
    """A watch over legs of three units, which all speak every period unless they are among the mute."""

    def __init__(self) -> None:
        self.legs = StillDevice("legs", ROBOT)
        self.legs.records = self.legs.records[:3]
        self.legs.rate = 250.0
        self.watch = DeviceWatch([self.legs])
        self.now = 10_000_000_000

    def run(self, seconds: float, mute: tuple[str, ...] = (), every: int = 1, deaf: bool = False) -> int:
        """Let time pass; returns how often a report was due.

        ``every``: so many periods, the first unit speaks. ``deaf``: nobody listens, to whatever it says.
        """
        reports = 0
        for k in range(round(seconds * 1e9) // PERIOD):
            self.now += PERIOD
            self.legs.looks += not deaf
            for record in self.legs.records:
                if not deaf and record.unit not in mute and (record.unit != "1" or k % every == 0):
                    record.received(self.now)
            reports += self.watch.update(self.now)
        return reports


def test_every_fault_of_every_part_has_a_reaction() -> None:
    assert set(REACTIONS) == set(Fault)
    for row in REACTIONS.values():
        assert set(row) == set(Part)
    for fault, row in REACTIONS.items():
        # What a hand feels never stops the robot, and legs are never less grave than anything else.
        assert row[Part.HAND] is Reaction.KEEP_BALANCE
        assert row[Part.LEGS].severity == max(reaction.severity for reaction in row.values()), fault


def test_a_unit_is_silent_after_its_time_and_no_longer_when_it_speaks() -> None:
    bench = Bench()
    bench.run(1.0)
    assert bench.watch.reaction is Reaction.KEEP_BALANCE
    bench.run(bench.legs.silent_after - 0.01, mute=("2",))
    assert not bench.watch.reactions
    bench.run(0.02, mute=("2",))
    (each,) = bench.watch.reactions
    assert (each.unit, each.fault, each.reaction) == ("legs/2", Fault.SILENT, Reaction.HOLD)
    report = bench.watch.report(bench.now)
    assert (report.reaction, report.states) == ("hold", ["ok", "silent", "ok"])
    assert report.reason.startswith("legs/2: no valid state")
    bench.run(0.02)
    assert not bench.watch.reactions and bench.watch.report(bench.now).reason == ""


def test_states_that_the_computer_has_not_read_are_overdue_then_unread() -> None:
    bench, imus = Bench(), Imus()
    bench.run(1.0)
    bench.run(UNREAD_AFTER - 0.01, deaf=True)
    assert {(each.fault, each.reaction) for each in bench.watch.reactions} == {(Fault.OVERDUE, Reaction.KEEP_BALANCE)}
    report = bench.watch.report(bench.now)
    assert report.states == ["overdue"] * 3 and "the computer has not read its port" in report.reason
    bench.run(0.004)
    assert not bench.watch.reactions
    bench.run(UNREAD_AFTER + 0.01, deaf=True)
    assert {(each.fault, each.reaction) for each in bench.watch.reactions} == {(Fault.UNREAD, Reaction.HOLD)}
    assert bench.watch.report(bench.now).states == ["unread"] * 3
    imus.run(1.0)
    report = imus.run(UNREAD_AFTER + 0.01, deaf=True)
    assert imus.watch.primary is imus.imu and report.reaction == "hold"


@given(st.lists(st.sampled_from(["speaks", "mute", "deaf"]), min_size=1, max_size=120))
def test_what_was_not_listened_to_is_held_against_no_one(periods: list[str]) -> None:
    """Only a unit that was listened to in vain is silent; and one that was, for long enough, is."""
    bench = Bench()
    bench.run(0.1)
    mute = 0
    for period in periods:
        bench.run(0.004, mute=("2",) if period == "mute" else (), deaf=period == "deaf")
        mute = mute + 1 if period == "mute" else 0 if period == "speaks" else mute
        told = {each.unit for each in bench.watch.reactions if each.fault is Fault.SILENT}
        assert told <= {"legs/2"} and (mute >= LOOKS_TO_SILENCE or not told)
        assert mute * 0.004 <= bench.legs.silent_after or told


def test_a_slow_unit_brings_the_robot_to_rest() -> None:
    bench = Bench()
    bench.run(3.5)
    assert bench.watch.reaction is Reaction.KEEP_BALANCE
    bench.run(3.5, every=10)
    (each,) = bench.watch.reactions
    assert (each.unit, each.fault, each.reaction) == ("legs/1", Fault.SLOW, Reaction.SOFT_STOP)
    bench = Bench()
    bench.run(3.04)
    bench.run(0.9, mute=("2",))
    bench.run(0.004)
    for _ in range(20):
        bench.run(0.1)
        assert not bench.watch.reactions, "a unit that was silent is not also slow"


def test_legs_without_power_go_limp_only_when_several_are() -> None:
    bench = Bench()
    bench.run(2.0)
    assert bench.run(4.0) == 4, "a report every second"
    bench.legs.report_faults([UnitFault("3", Fault.WARM, "90 °C")])
    assert bench.run(0.004) == 1, "and on change"
    assert (bench.watch.reason, bench.watch.reaction) == ("legs/3: 90 °C", Reaction.SOFT_STOP)
    bench.legs.report_faults([UnitFault("1", Fault.DISABLED, "off")])
    bench.run(0.01)
    assert bench.watch.reaction is Reaction.HOLD
    bench.legs.report_faults([UnitFault("1", Fault.DISABLED, "off"), UnitFault("2", Fault.DISABLED, "off")])
    bench.run(0.01)
    assert bench.watch.reaction is Reaction.LIMP


@given(st.lists(st.floats(0.0, 120.0, allow_nan=False), min_size=1, max_size=30))
def test_a_level_is_left_only_well_below_its_limit(temperatures: list[float]) -> None:
    level = 0
    for temperature in temperatures:
        before, level = level, _level(temperature, (75.0, 95.0), level, 3.0)
        plain = (temperature >= 75.0) + (temperature >= 95.0)
        assert level >= plain
        if level > plain:
            assert level == before and temperature > (75.0, 95.0)[level - 1] - 3.0


def status(reaction: str) -> DeviceStatus:
    numbers = [0.0]
    return DeviceStatus(0, ["legs/1"], ["silent"], ["x"], *([numbers] * 6), reaction, "legs/1: x")  # type: ignore[arg-type, call-arg]


def arrive(fsm: BehaviorFsm, target: Behavior) -> None:
    ways: list[list[Behavior]] = [[Behavior.IDLE]]
    while ways[0][-1] is not target:
        way = ways.pop(0)
        ways += [[*way, following] for following in BEHAVIOR_TRANSITIONS[way[-1]] if following not in way]
    for behavior in ways[0][1:]:
        fsm.go(behavior, "test")


@pytest.mark.parametrize("start", Behavior)
@pytest.mark.parametrize("reaction", DEMANDS)
def test_the_motion_manager_gets_where_the_devices_demand(start: Behavior, reaction: str) -> None:
    fsm = BehaviorFsm()
    arrive(fsm, start)
    stepping = [True]
    reactions = DeviceReactions(fsm, lambda: stepping[0])
    reactions.receive(status(reaction))
    reactions.update()
    if reaction == "keep_balance":
        assert fsm.behavior is start
        return
    walking = start in (Behavior.WALK, Behavior.WALK_MANIPULATE, Behavior.STEP, Behavior.STEP_MANIPULATE)
    if walking and reaction != "limp":
        assert fsm.behavior is Behavior.SOFT_STOP, "what has begun comes to rest first"
    stepping[0] = False
    for _ in range(5):
        reactions.update()
    balancing = {"soft_stop": Behavior.SOFT_STOP, "hold": Behavior.FREEZE, "limp": Behavior.FALL}[reaction]
    expected = {
        Behavior.IDLE: Behavior.IDLE,
        Behavior.FALL: Behavior.FALL,
        Behavior.GET_UP: Behavior.GET_UP if reaction == "soft_stop" else Behavior.FALL,
        Behavior.FREEZE: Behavior.FALL if reaction == "limp" else Behavior.FREEZE,
        # Held on its way to limp: there is no other from where nobody balances.
        Behavior.STAND_PREP: {"soft_stop": Behavior.STAND_PREP, "hold": Behavior.FREEZE, "limp": Behavior.FALL}[
            reaction
        ],
        Behavior.SOFT_STOP: balancing,
    }.get(start, balancing)
    assert fsm.behavior is expected
    if fsm.behavior is not start:
        assert fsm.reason == "legs/1: x"
    reactions.receive(status("keep_balance"))
    reactions.update()
    assert fsm.behavior is expected, "it never leads back by itself"


class Imus:
    def __init__(self) -> None:
        tables = ROBOT.tables.devices
        devices = {"imu": tables["imu"], "kvh": Kvh1750(serial="1", rate=250)}
        robot = RobotDescription(ROBOT.folder, structs.replace(ROBOT.tables, devices=devices))
        self.imu, self.kvh = StillDevice("imu", robot), StillDevice("kvh", robot)
        self.imu.rate = self.kvh.rate = 250.0
        self.watch = DeviceWatch([self.imu, self.kvh])
        self.now = 10_000_000_000

    def run(self, seconds: float, mute: Sequence[StillDevice] = (), deaf: bool = False) -> DeviceStatus:
        for _ in range(round(seconds * 1e9) // PERIOD):
            self.now += PERIOD
            for device in (self.imu, self.kvh):
                device.looks += not deaf
                if device not in mute and not deaf:
                    device.records[0].received(self.now)
            self.watch.update(self.now)
        return self.watch.report(self.now)


def test_the_first_imu_leads_and_is_followed_by_the_next_when_it_is_silent() -> None:
    imus = Imus()
    report = imus.run(1.0)
    assert imus.watch.primary is imus.imu
    assert (report.states, report.details) == (["ok", "ok"], ["primary", "stand-by"])
    report = imus.run(0.11, mute=[imus.imu])
    assert imus.watch.primary is imus.kvh, "as soon as silence is told"
    assert (report.reaction, report.states) == ("keep_balance", ["silent", "ok"])
    assert report.details == ["no valid state for 0.1 s (kvh is primary)", "primary"]
    assert report.reason == "imu: no valid state for 0.1 s (kvh is primary)"
    report = imus.run(0.5)
    assert imus.watch.primary is imus.kvh, "a recovered IMU is stand-by"
    assert (report.states, report.details, report.reason) == (["ok", "ok"], ["stand-by", "primary"], "")


def test_imus_that_all_fail_have_the_joints_held() -> None:
    imus = Imus()
    imus.run(1.0)
    report = imus.run(0.2, mute=[imus.imu, imus.kvh])
    assert (report.reaction, report.states) == ("hold", ["silent", "silent"])
    assert imus.watch.primary is imus.imu, "as none is better off"
    assert report.reason == "imu: no valid state for 0.1 s"
    report = imus.run(0.05, mute=[imus.imu])
    assert imus.watch.primary is imus.kvh and report.reaction == "keep_balance"


def test_an_imu_that_says_that_it_is_ill_leads_no_more() -> None:
    imus = Imus()
    imus.run(1.0)
    imus.imu.report_faults([UnitFault("imu", Fault.FAULTY, "its filter is in state 3")])
    report = imus.run(0.004)
    assert imus.watch.primary is imus.kvh and report.reaction == "keep_balance"
    imus.kvh.report_faults([UnitFault("kvh", Fault.WARM, "71 °C")])
    report = imus.run(0.004)
    assert imus.watch.primary is imus.kvh and report.reaction == "soft_stop", "better than one that must be held"


def test_an_imu_whose_tilt_is_another_one_does_not_take_over() -> None:
    imus = Imus()

    def tilted(angle: float) -> ImuMeasurement:
        stamp = time.monotonic_ns() + 60_000_000_000  # fresh, however long this computer takes
        orientation = np.array([math.cos(0.5 * angle), math.sin(0.5 * angle), 0.0, 0.0])
        return ImuMeasurement(stamp, orientation, np.zeros(3), np.zeros(3))

    imus.imu.attitude, imus.kvh.attitude = tilted(0.1), tilted(0.1 + 0.9 * DISAGREEMENT)
    assert imus.run(1.0).states == ["ok", "ok"]
    imus.kvh.attitude = tilted(0.1 + 1.2 * DISAGREEMENT)
    report = imus.run(0.15)
    assert (report.reaction, report.states) == ("keep_balance", ["ok", "faulty"])
    assert report.details[1] == "its tilt is 0.06 rad off that of imu; expected up to 0.05 rad (imu is primary)"
    report = imus.run(0.2, mute=[imus.imu])
    assert imus.watch.primary is imus.imu and report.reaction == "hold"
    imus.kvh.attitude = tilted(0.1)
    assert imus.run(0.15).states == ["ok", "ok"]
    imus.run(0.2, mute=[imus.imu])
    assert imus.watch.primary is imus.kvh
