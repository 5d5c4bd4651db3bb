"""The rows of docs/reliability.md: which are measured, how they are written down, which tests hold them besides.

``python -m tests.soak.rows build/reliability.jsonl`` prints the tables of what ``make soak`` and ``make reliability``
have measured.
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.soak.activities import ACTIVITIES
from tests.soak.rules import BY_ITSELF

if TYPE_CHECKING:
    from tests.soak.run import Outcome

HEAD = "| event | goes on while | else | times | ready after [s] |"
GOES_ON, NOT_WELL = "goes on", "not well within 60 s"
_MANAGER = "tests/integration/test_motion_manager.py::"
_KILLED = "tests/integration/test_motion_manager_killed.py::"
_HARDWARE = "tests/integration/test_hardware.py::"
_RECORDER = "tests/integration/bag_recorder/test_losses.py::"
_DRIVER = "tests/integration/test_hdt_arms.py::test_driver_and_bridge_may_die_and_come_back_without_a_jump"
_HELD = f"{_KILLED}test_whoever_is_killed_no_joint_moves_until_somebody_commands_it"
_MIDDLE = f"{_KILLED}test_whoever_is_killed_or_stopped_in_the_middle_of_a_step_the_robot_comes_to_stand"
# fmt: off
HELD_BY: Mapping[tuple[str, str, str], str] = {
    ("kill motion_manager", "standing", "sim"): _HELD,
    ("kill motion_manager", "frozen", "sim"): _HELD,
    ("kill motion_manager", "fallen", "sim"): _HELD,
    ("kill motion_manager", "walking", "sim"): _MIDDLE,
    ("stop motion_manager 7 s", "walking", "sim"): _MIDDLE,
    ("kill comms_manager", "standing", "sim"): f"{_KILLED}test_a_killed_comms_manager_is_a_fall_with_its_reason",
    ("kill motion_manager and comms_manager", "standing", "sim"):
        f"{_KILLED}test_both_managers_killed_the_robot_is_not_brought_to_its_feet",
    ("kill valor_ros_controller", "reaching", "sim"):
        "tests/integration/vrc/test_when_processes_die.py::test_killed_it_comes_back_with_the_true_mode_and_the_arms_hold",
    ("kill bifrostd", "standing", "sim"):
        "tests/bifrost/test_daemon.py::test_data_flows_while_the_daemon_is_dead_and_all_register_again",
    ("kill bag_recorder", "standing", "sim"):
        f"{_RECORDER}test_a_killed_recorder_leaves_a_bag_that_the_next_one_finishes",
    ("full disk", "standing", "sim"): f"{_RECORDER}test_a_full_disk_costs_no_more_than_what_does_not_fit",
    ("garbage bytes", "standing", "sim"):
        "tests/bifrost/test_security.py::test_garbage_on_every_port_ends_nothing_and_delays_nobody",
    ("flood over Bifrost", "reaching", "sim"):
        f"{_MANAGER}test_who_floods_is_named_and_muted_while_the_motors_go_on",
    ("malformed messages", "standing", "sim"):
        f"{_MANAGER}test_commands_are_refused_with_their_reasons_and_the_robot_stands_on",
    ("kill motion_manager", "standing", "hardware"):
        f"{_HARDWARE}test_the_motion_manager_may_die_under_a_standing_robot_and_no_joint_moves",
    ("kill comms_manager", "standing", "hardware"):
        f"{_HARDWARE}test_the_comms_manager_may_die_under_a_standing_robot_and_come_back",
    ("unplug legs/1", "standing", "hardware"):
        f"{_HARDWARE}test_a_controller_that_lost_its_power_is_found_and_switched_on_again",
    ("unplug imu", "standing", "hardware"): f"{_HARDWARE}test_the_imu_is_unplugged_and_plugged_in_again",
    ("unplug hdt/left_arm", "standing", "hardware"):
        "tests/integration/test_hdt_arms.py::test_a_limb_that_is_unplugged_is_found_where_it_hangs",
    ("kill hdt_driver", "reaching", "hardware"): _DRIVER,
    ("kill hdt_bridge", "reaching", "hardware"): _DRIVER,
}
# fmt: on
"""Tests of their own, beside the soak that may draw any row: (event, activity, profile) → test."""
_ALL = ("standing", "walking", "stepping", "reaching", "soft stop", "frozen", "fallen")
_SOME = ("standing", "walking", "reaching", "fallen")
_FEW = ("standing", "walking")
_STANDING = ("standing",)
MEASURED: Sequence[tuple[str, Sequence[str]]] = (
    ("kill motion_manager", _ALL),
    ("stop motion_manager 7 s", _ALL),
    ("kill comms_manager", _ALL),
    ("stop comms_manager 7 s", _ALL),
    ("kill valor_ros_controller|stop valor_ros_controller 7 s", _SOME),
    ("kill (bifrostd|bag_recorder|footstep_converter)", ("standing", "walking", "stepping")),
    ("stop (bifrostd|bag_recorder|footstep_converter) 7 s", ("standing", "walking", "stepping")),
    ("kill (hdt_driver|hdt_bridge)", ("standing", "reaching")),
    ("kill device_emulators", _STANDING),
    ("kill .* and .*", _FEW),
    ("kill .* during up", _STANDING),
    ("flood over .*", _SOME),
    ("starved of CPU", ("standing", "walking", "stepping", "reaching")),
    ("garbage bytes|malformed messages|wrong ROS messages", _FEW),
    ("links of .* cut", ("standing", "walking", "frozen")),
    ("unplug .*", _FEW),
    ("full disk", _FEW),
    ("memory of .* capped", _FEW),
)
"""Event (its whole name) → what the robot does meanwhile: rows worth an hour of measuring, the first that fits."""


def _line_of(event: str) -> int | None:
    """Where in the table of what is measured an event stands; None: nowhere."""
    return next((i for i, (name, _) in enumerate(MEASURED) if re.fullmatch(name, event)), None)


def everything(events: Iterable[str]) -> list[str]:
    """All rows that are measured, of the events that a profile has."""
    rows = []
    for event in events:
        if (line := _line_of(event)) is not None:
            rows += [f"{activity}/{event}" for activity in MEASURED[line][1]]
    return rows


def add(file: Path, profile: str, outcome: Outcome) -> None:
    """Write a step down, as a line of JSON."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a") as lines:
        lines.write(json.dumps(vars(outcome) | {"profile": profile, "load": os.getloadavg()[0]}) + "\n")


def read(file: Path) -> list[dict[str, Any]]:
    """What was written down; nothing yet: none."""
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def to_do(file: Path | None, profile: str, wanted: Sequence[str], times: int) -> Iterator[tuple[str, int]]:
    """Rows, each with which time it is, until each was measured so often; those measured least come first."""
    written = read(file) if file else []
    done = Counter(f"{each['activity']}/{each['event']}" for each in written if each["profile"] == profile)
    for time_ in range(times):
        for row in wanted:
            if done[row] <= time_:
                yield row, time_
                done[row] += 1


def table(outcomes: Iterable[Mapping[str, Any]], profile: str) -> list[str]:
    """The lines of a profile's table in Markdown: a row for what is measured together and ends in the same ways."""
    made: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for each in _measured(outcomes, profile):
        made[each["event"]].append(each)
    alike: dict[tuple[int | None, frozenset[str]], list[str]] = defaultdict(list)
    for event in sorted(made, key=lambda each: (_line_of(each), each)):
        alike[_line_of(event), frozenset(_word(each) for each in made[event])].append(event)
    rows = [_row(events, [each for event in events for each in made[event]]) for events in alike.values()]
    return [HEAD, "|" + HEAD.count(" | ") * "---|" + "---|", *rows]


def farthest(outcomes: Iterable[Mapping[str, Any]], profile: str) -> float:
    """How far a joint went at most that was to stay where it is [rad]; not a number where none was."""
    still = [
        each["moved"]
        for each in _measured(outcomes, profile)
        if ACTIVITIES[each["activity"]].held and _word(each) != "fall" and not math.isnan(each["moved"])
    ]
    return max(still, default=math.nan)


def _measured(outcomes: Iterable[Mapping[str, Any]], profile: str) -> Iterator[Mapping[str, Any]]:
    for each in outcomes:
        begun = bool(each["before"])  # else the robot never came to do that
        if each["profile"] == profile and begun and _line_of(each["event"]) is not None:
            yield each


def _word(outcome: Mapping[str, Any]) -> str:
    before, after = outcome["before"], outcome["after"]
    if not after:
        return NOT_WELL
    on = before == after or after in BY_ITSELF.get(before, ())
    on = on and not outcome["event"].endswith("during up")
    return GOES_ON if on else str(after)


def _row(events: Sequence[str], outcomes: Sequence[Mapping[str, Any]]) -> str:
    ends: dict[str, set[str]] = defaultdict(set)
    for each in outcomes:
        ends[_word(each)].add(each["activity"])
    on = _in_order(ends.pop(GOES_ON, set())) or "–"
    other = "; ".join(f"{word}: {_in_order(activities)}" for word, activities in sorted(ends.items())) or "–"
    ready = [each["ready"] for each in outcomes if not math.isnan(each["ready"])]
    return f"| {', '.join(events)} | {on} | {other} | {len(outcomes)} | {f'{max(ready):.1f}' if ready else '–'} |"


def _in_order(activities: Collection[str]) -> str:
    return ", ".join(each for each in ACTIVITIES if each in activities)


if __name__ == "__main__":
    measured = read(Path(sys.argv[1]))
    for each in sorted({outcome["profile"] for outcome in measured}, reverse=True):
        print(f"### Profile `{each}`", "", *table(measured, each), "", sep="\n")
        print(f"No joint that was to stay moved more than {farthest(measured, each):.2f} rad.\n")
