"""The rows of docs/reliability.md: which are measured, how they are written down, which tests hold them besides.

``python -m tests.soak.rows build/reliability.json`` prints the table of what ``make reliability`` has measured.
"""

from __future__ import annotations

import json
import math
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

HEAD = "| event | the robot | profile | is then | everything ready after [s]: median, worst | times | held by |"
SOAK = "tests/unit/test_soak_rows.py::test_every_row_is_one_that_the_soak_knows_and_allows"
_MANAGER = "tests/integration/test_motion_manager.py::"
_HELD = f"{_MANAGER}test_whoever_is_killed_no_joint_moves_until_somebody_commands_it"
_MIDDLE = f"{_MANAGER}test_whoever_is_killed_or_stopped_in_the_middle_of_a_step_the_robot_comes_to_stand"
HELD_BY: Mapping[tuple[str, str, str], str] = {
    (
        "kill motion_manager",
        "standing",
        "sim",
    ): _HELD,
    (
        "kill motion_manager",
        "frozen",
        "sim",
    ): _HELD,
    ("kill motion_manager", "walking", "sim"): _MIDDLE,
    ("stop motion_manager 7 s", "walking", "sim"): _MIDDLE,
    (
        "kill motion_manager",
        "fallen",
        "sim",
    ): _HELD,
    ("kill comms_manager", "standing", "sim"): f"{_MANAGER}test_a_killed_comms_manager_is_a_fall_with_its_reason",
    ("kill comms_manager", "standing", "hardware"): "tests/integration/test_hardware.py::"
    "test_the_comms_manager_may_die_under_a_standing_robot_and_come_back",
    ("stop motion_manager 7 s", "standing", "sim"): "tests/integration/test_comms_manager.py::"
    "test_waits_out_a_stopped_controller_and_never_replays",
    ("kill bifrostd", "standing", "sim"): "tests/bifrost/test_daemon.py::"
    "test_data_flows_while_the_daemon_is_dead_and_all_register_again",
    ("kill bag_recorder", "standing", "sim"): "tests/integration/test_bag_recorder.py::"
    "test_a_killed_recorder_leaves_a_bag_that_the_next_one_finishes",
    ("garbage bytes", "standing", "sim"): "tests/bifrost/test_security.py::"
    "test_garbage_on_every_port_ends_nothing_and_delays_nobody",
}
"""Tests of their own, beside the soak that draws every row at random: (event, activity, profile) → test."""


def everything(events: Iterable[str], activities: Iterable[str]) -> list[str]:
    """All rows: every process killed and stopped for 7 s, and what else happens, whatever the robot does."""
    measured = [each for each in events if each.startswith("kill ") or each.endswith("7 s") or each in _BESIDES]
    return [f"{activity}/{event}" for event in measured for activity in activities]


_BESIDES = ("starved of CPU", "flood over Bifrost", "flood over ROS", "garbage bytes", "malformed messages")


def table(outcomes: Sequence[Mapping[str, Any]]) -> list[str]:
    """The lines of the table in Markdown."""
    rows: dict[tuple[str, str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for each in outcomes:
        rows[each["event"], each["activity"], each["profile"]].append(each)
    lines = [HEAD, "|---|---|---|---|---|---|---|"]
    for (event, activity, profile), made in sorted(rows.items()):
        after = Counter(each["after"] or "not well within 60 s" for each in made)
        then = ", ".join(name if count == len(made) else f"{name} {count}" for name, count in after.most_common())
        ready = sorted(each["ready"] for each in made if not math.isnan(each["ready"]))
        times = f"{median(ready):.1f}, {ready[-1]:.1f}" if ready else "–"
        name = HELD_BY.get((event, activity, profile), SOAK).rpartition("::")
        lines.append(f"| {event} | {activity} | {profile} | {then} | {times} | {len(made)} | `{name[2]}` |")
    return lines


if __name__ == "__main__":
    print("\n".join(table(json.loads(Path(sys.argv[1]).read_text()))))
