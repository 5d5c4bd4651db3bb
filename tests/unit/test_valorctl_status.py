"""How robot time has run since the start, from what the clock says."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.common.instance import ClockMode, Settings
from valor.common.messages import ClockStatus
from valor.valorctl.status import Status


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
