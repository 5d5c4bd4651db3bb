"""What `status` says: how robot time has run, how the robot fares, and what to do about it."""

from __future__ import annotations

import time
from dataclasses import replace
from datetime import datetime
from io import StringIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from valor.common.instance import ClockMode, Settings
from valor.common.messages import ClockStatus
from valor.common.processes import BY_NAME
from valor.valorctl.health import Health
from valor.valorctl.status import Condition, Status
from valor.valorctl.status_view import BAD, view


def status(mode: ClockMode, pace: float, robot_time: float, slip: float) -> Status:
    settings = Settings(robot=Path("escher"), ros_domain_id=1, clock=mode, real_time_factor=pace)
    clock = ClockStatus(mode, round(robot_time * 1e9), 1.0, slip, 0, False)
    return Status("default", settings, None, None, clock, [])


@given(st.floats(0.1, 8.0), st.floats(0.01, 1e5), st.floats(0.0, 1e3))
def test_the_walls_time_is_robot_time_and_slip_at_the_pace(pace: float, passed: float, slip: float) -> None:
    factor = status("lockstep", pace, passed, slip).factor_since_start
    assert factor is not None
    on_the_wall = (passed + slip) / pace
    assert factor * on_the_wall == pytest.approx(passed, rel=1e-6)
    # In realtime the pace is the wall's own, whatever the settings say of lockstep's.
    assert status("realtime", pace, passed, slip).factor_since_start == pytest.approx(factor / pace)


def test_what_cannot_be_said_is_none() -> None:
    assert status("lockstep", 0.0, 5.0, 0.0).factor_since_start is None
    assert status("lockstep", 1.0, 0.0, 0.0).factor_since_start is None
    settings = status("lockstep", 1.0, 1.0, 0.0).settings
    assert Status("default", settings, None, None, None, []).factor_since_start is None


def test_json_tells_both_windows() -> None:
    clock = status("lockstep", 1.0, 9.0, 1.0).as_json()["clock"]
    assert clock["real_time_factor"] == 1.0
    assert clock["real_time_factor_since_start"] == pytest.approx(0.9)


def shown(status: Status, width: int) -> list[str]:
    """What stands on a screen of that width."""
    screen = StringIO()
    console = Console(width=width, highlight=False, file=screen)
    console.print(view(status))
    return screen.getvalue().splitlines()


BEGAN = time.time() - 44.0
BAG = Path("/home/somebody/.valor/lab/bags/2026-01-31_14-05-00/2026-01-31_14-05-00.mcap")
FALLEN = replace(
    status("lockstep", 1.0, 45.0, 12.3),
    instance="lab",
    behavior="fall",
    control_mode="none",
    condition=Condition("the pelvis is tilted 62°", 42.0, BEGAN, BAG),
    services=[Health("motion_manager", "failed", 1234567, 100.0, 1108.0, 12, "runs, but silent for 12.3 s")],
)


@pytest.mark.parametrize("width", [80, 120])
def test_a_fall_is_told_with_its_reason_time_way_out_and_bag(width: int) -> None:
    lines = shown(FALLEN, width)
    text = "\n".join(lines)
    assert (
        f"fallen since {datetime.fromtimestamp(BEGAN):%H:%M:%S} (42.0 s of robot time): the pelvis is tilted 62°"
        in lines
    )
    assert "→ valorctl get-up --instance lab" in lines
    assert str(BAG) in text
    assert all(len(line.rstrip()) <= width for line in lines)
    colours = {span.style for line in view(FALLEN).renderables[:5] for span in getattr(line, "spans", ())}
    assert BAD in colours
    told = FALLEN.as_json()
    assert (told["fallen"], told["reason"], told["since_s"], told["bag"]) == (
        True,
        "the pelvis is tilted 62°",
        42.0,
        str(BAG),
    )
    assert told["way_out"] == "valorctl get-up --instance lab"


def test_what_a_process_takes_stands_beside_its_budget() -> None:
    row = BY_NAME["motion_manager"]
    assert f"100 of {row.cpu_budget:.0f}" in "\n".join(shown(FALLEN, 120))
    [service] = FALLEN.as_json()["services"]
    assert service["needs"] == [*row.needs, *row.after]
    assert service["description"] == row.description
    assert (service["cpu_budget_percent"], service["memory_budget_mib"]) == (row.cpu_budget, row.memory_budget)


def test_who_stands_needs_no_way_out() -> None:
    standing = replace(
        FALLEN, behavior="stand", condition=Condition("requested by somebody", 1.0, time.time() - 44.0, None)
    )
    text = "\n".join(shown(standing, 120))
    assert "behavior stand for 44 s: requested by somebody" in text
    assert "→" not in text
    assert standing.as_json()["way_out"] is None
    assert standing.as_json()["fallen"] is False
