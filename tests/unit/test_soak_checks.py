"""Each check of the soak sees the fault that it is for, and nothing in what is well."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.writer import Writer as McapWriter

from harness.motion_states import motion_state
from harness.places import ROBOTS
from tests.soak import checks, rules
from valor.common.behaviors import OPERATIONAL, Behavior
from valor.common.messages import Motor
from valor.motion_manager.states.transitions import BEHAVIOR_TRANSITIONS, RESUMED
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")


@dataclass
class Writer:
    """Makes one sound Motor after the other."""

    writer: int = 1
    sequence: int = 0

    def motor(self, behavior: str = "stand", **changes: Any) -> Motor:
        self.sequence += 1
        n = len(ROBOT.joints)
        sound = Motor(
            time=self.sequence,
            sequence=self.sequence,
            proprioceptor_sequence=self.sequence,
            mode=np.ones(n, np.uint8),
            position=ROBOT.nominal_posture.copy(),
            velocity=np.zeros(n),
            effort=np.zeros(n),
            stiffness=np.zeros(n),
            damping=np.zeros(n),
            behavior=behavior,
            writer=self.writer,
        )
        return msgspec.structs.replace(sound, **changes)


def vector(value: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Zero but for one joint."""
    made = np.zeros(len(ROBOT.joints))
    made[3] = value
    return made


def at(position: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The nominal posture but for that joint."""
    made = ROBOT.nominal_posture.copy()
    made[3] = position
    return made


def test_sound_motors_are_well() -> None:
    tried, writer = checks.MotorChecks(ROBOT), Writer()
    assert [tried.find(writer.motor(each)) for each in ("stand", "stand", "walk", "stand", "freeze")] == [[]] * 5
    tried = checks.MotorChecks(ROBOT)
    assert [tried.find(writer.motor(each)) for each in ("step", "stand_manipulate")] == [[]] * 2, (
        "two requests in a period"
    )


def test_one_that_stands_aside_begins_at_rest() -> None:
    tried, writer = checks.MotorChecks(ROBOT), Writer()
    assert [tried.find(writer.motor(each)) for each in ("walk", "reflex", "reflex", "freeze")] == [[]] * 4
    assert [tried.find(writer.motor(each)) for each in ("stand_prep", "stand", "walk", "reflex")] == [[]] * 4
    assert "walk after walk" in tried.find(writer.motor("walk"))[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"effort": vector(np.nan)}, "effort not finite"),
        ({"stiffness": vector(np.inf)}, "stiffness not finite"),
        ({"position": at(ROBOT.upper[3] + 0.001)}, f"position of {ROBOT.joints[3]} beyond"),
        ({"position": at(ROBOT.lower[3] - 0.001)}, f"position of {ROBOT.joints[3]} beyond"),
        ({"effort": vector(-1.001 * ROBOT.effort_limit[3])}, f"effort of {ROBOT.joints[3]} beyond"),
        ({"sequence": 1}, "sequence goes back"),
        ({"behavior": "get_up"}, "no edge"),
        ({"behavior": "dance"}, "unknown behavior"),
        ({"writer": 2, "behavior": "stand"}, "after a restart"),
        ({"writer": 0, "behavior": "freeze"}, "another one has followed"),
    ],
)
def test_a_motor_that_is_not_is_named(changes: dict[str, Any], words: str) -> None:
    tried, writer = checks.MotorChecks(ROBOT), Writer()
    assert not tried.find(writer.motor())
    found = tried.find(writer.motor(**changes))
    assert len(found) == 1
    assert words in found[0]


def test_a_report_that_is_not_its_motors_is_found() -> None:
    tried, writer = checks.StateChecks(), Writer()
    tried.motor(writer.motor("freeze"))
    report = motion_state(proprioceptor_sequence=writer.sequence, behavior="freeze")
    assert tried.find(report) == []
    assert "says stand" in tried.find(msgspec.structs.replace(report, behavior="stand"))[0]
    unheard = msgspec.structs.replace(report, behavior="stand", proprioceptor_sequence=99)
    assert tried.find(unheard) == []


def test_memory_that_grows_after_the_start_is_found() -> None:
    times = [10.0 * each for each in range(40)]
    assert checks.growth([(t, 100.0 + min(t, 50.0)) for t in times]) == pytest.approx(0.0)
    assert checks.growth([(t, 100.0 + 0.1 * t) for t in times]) > checks.GROWTH
    assert checks.growth([(t, 100.0 + t) for t in times[:8]]) == 0.0  # too short to tell


def test_what_is_lost_or_comes_before_another_is_found() -> None:
    asked = ["stand", "walk", "stand", "step"]
    assert checks.order_kept(asked, asked)
    assert checks.order_kept(asked, ["walk", "step"])
    assert not checks.order_kept(asked, asked[:-1])
    assert not checks.order_kept(asked, ["walk", "stand", "walk", "step"])
    assert not checks.order_kept([], ["walk"])


@pytest.mark.parametrize("word", ["Traceback (most recent call last):", "Assertion failed: !_io_error", "SIGSEGV"])
def test_a_crash_is_found_in_logs(tmp_path: Path, word: str) -> None:
    (tmp_path / "a.log").write_text("all is well\n")
    assert checks.in_logs(tmp_path) == []
    (tmp_path / "b.log.1").write_text(f"x {word} y\n")
    assert len(checks.in_logs(tmp_path)) == 1


def test_a_bag_that_was_not_finished_is_found_and_one_that_cannot_be_read(tmp_path: Path) -> None:
    with (tmp_path / "whole.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema("a", "ros2msg", b""))
        for stamp in range(1000):
            writer.add_message(channel, stamp, b"x" * 1000, stamp)
        writer.finish()
    assert checks.unreadable(tmp_path) == []
    whole = (tmp_path / "whole.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "no.mcap").write_text("no bag")
    found = checks.unreadable(tmp_path)
    assert found[0] == "cut.mcap was left unfinished" and "no.mcap" in found[1] and len(found) == 2


def test_an_end_that_nobody_caused_is_found() -> None:
    assert checks.unexpected_ends({"a": 2}, {"a": 2}) == []
    assert checks.unexpected_ends({"a": 3}, {"a": 2}) == ["a ended 1 times by itself"]


@pytest.mark.parametrize("behavior", Behavior)
def test_every_kill_has_outcomes_by_the_tables(behavior: Behavior) -> None:
    after = rules.outcomes("kill", "motion_manager", behavior)
    assert RESUMED[behavior] in after
    assert (Behavior.FALL in after) == (behavior in rules.STEPPING or RESUMED[behavior] is Behavior.FALL)
    assert behavior in rules.outcomes("kill", "bag_recorder", behavior)
    assert rules.outcomes("", "", Behavior.STAND) == {Behavior.STAND}


@pytest.mark.parametrize("behavior", Behavior)
def test_what_may_end_in_two_ways_has_the_outcomes_of_both(behavior: Behavior) -> None:
    for process in ("motion_manager", "comms_manager", "bag_recorder"):
        both = {*rules.outcomes("kill", process, behavior), *rules.outcomes("stop", process, behavior)}
        assert rules.outcomes("cap", process, behavior) == both
    assert behavior in rules.outcomes("unplug", "hdt/left_arm", behavior)
    needed = rules.outcomes("unplug", "imu", behavior)
    assert (Behavior.FREEZE in needed) == (behavior in {*OPERATIONAL, Behavior.SOFT_STOP, Behavior.FREEZE})


def test_the_way_is_one_of_edges() -> None:
    assert rules.way(Behavior.STAND, Behavior.STAND) == []
    assert rules.way(Behavior.FREEZE, Behavior.STAND) == [Behavior.STAND_PREP, Behavior.STAND]
    for start in set(Behavior) - {Behavior.GET_UP}:
        here: Behavior = start
        for after in rules.way(start, Behavior.STAND):
            assert after in BEHAVIOR_TRANSITIONS[here]
            here = after
        assert here is Behavior.STAND


def test_modes_and_behaviors_fit_as_the_vrcs_table_says() -> None:
    modes = rules.Modes()
    assert modes.fit("manipulate", "stand_manipulate")
    assert modes.fit("none", "fall")
    assert not modes.fit("walk", "stand")
    assert not modes.fit("stand", "fall")
