"""Logs of several processes as one: by time, from a moment on, by level, and on as they grow."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance
from valor.valorctl.log_reader import LEVELS, LogReader, moment
from valor.valorctl.log_view import LogView

MANAGER = """\
a library that knows no time
2026-01-31 23:59:58,100 INFO motion_manager: one
2026-01-31 23:59:59,900 ERROR motion_manager: three
Traceback (most recent call last):
  File "x", line 1
2026-02-01 00:00:00,300 INFO motion_manager: five
"""
COMMS = "2026-01-31 23:59:58,500 WARNING comms_manager: two\n2026-02-01 00:00:00,100 INFO comms_manager: four\n"


@pytest.fixture
def instance(tmp_path: Path) -> Instance:
    made = Instance("lab", tmp_path)
    made.logs.mkdir(parents=True)
    (made.logs / "motion_manager.log").write_text(MANAGER)
    (made.logs / "comms_manager.log").write_text(COMMS)
    return made


def texts(reader: LogReader) -> list[str]:
    return [line.text for line in reader.take()]


TRACE = ["Traceback (most recent call last):", '  File "x", line 1']


def test_lines_come_in_the_order_of_time_across_midnight(instance: Instance) -> None:
    with LogReader(instance, None) as reader:
        assert texts(reader) == ["a library that knows no time", "one", "two", "three", *TRACE, "four", "five"]
        assert reader.take() == []
        with open(instance.logs / "comms_manager.log", "a") as log:
            log.write("2026-02-01 00:00:01,000 INFO comms_manager: six\n2026-02-01 00:00:02,000 INFO comms")
            log.flush()
            assert texts(reader) == ["six"]
            log.write("_manager: seven\n")
            log.flush()
            assert texts(reader) == ["seven"]
        (instance.logs / "motion_manager.log").unlink()
        (instance.logs / "motion_manager.log").write_text("2026-02-01 00:00:03,000 INFO motion_manager: anew\n")
        assert texts(reader) + texts(reader) == ["anew"]


def test_what_was_moved_out_of_a_full_logs_way_is_read_where_it_is_asked_for(instance: Instance) -> None:
    comms = instance.logs / "comms_manager.log"
    comms.with_name("comms_manager.log.2").write_text("2026-01-31 23:59:50,000 INFO comms_manager: oldest\n")
    # What a process prints is not cut at the ends of lines.
    log, begun = (
        "2026-01-31 23:59:55,000 INFO comms_manager: older\n2026-01-31 23:59:5",
        "7,000 INFO comms_manager: old",
    )
    comms.with_name("comms_manager.log.1").write_text(log)
    comms.write_text(f"{begun}\n{COMMS}")
    with LogReader(instance, "comms_manager") as reader:
        assert texts(reader) == ["oldest", "older", "old", "two", "four"]
        with open(comms, "a") as file:
            file.write("2026-02-01 00:00:01,000 INFO comms_manager: six\n")
        assert texts(reader) == ["six"]
    with LogReader(instance, "comms_manager", datetime(2026, 1, 31, 23, 59, 54)) as reader:
        assert texts(reader) == ["older", "old", "two", "four", "six"]
    with LogReader(instance, "comms_manager", level="warning", lines=1) as reader:
        assert texts(reader) == ["two"]
    with LogReader(instance, "comms_manager", lines=4) as reader:
        assert texts(reader)[-4:] == ["old", "two", "four", "six"]
    with LogReader(instance, None, datetime(2026, 1, 31, 23, 59, 56)) as reader:
        assert texts(reader)[:4] == ["old", "a library that knows no time", "one", "two"]


def test_a_full_log_is_not_read_where_the_newest_lines_are_enough(instance: Instance) -> None:
    full = instance.logs / "comms_manager.log.1"
    full.mkdir()  # who reads it fails
    with LogReader(instance, "comms_manager", lines=2) as reader:
        assert texts(reader) == ["two", "four"]
    with LogReader(instance, "comms_manager", datetime(2026, 1, 31, 23, 59, 59)) as reader:
        assert texts(reader) == ["four"]


def test_a_moment_and_a_level_leave_out_what_is_older_and_less_grave(instance: Instance) -> None:
    with LogReader(instance, None, datetime(2026, 1, 31, 23, 59, 59)) as reader:
        assert texts(reader) == ["three", *TRACE, "four", "five"]
    with LogReader(instance, None, level="warning") as reader:
        assert texts(reader) == ["two", "three", *TRACE]
    with LogReader(instance, "comms_manager", level="error") as reader:
        assert texts(reader) == []


def test_a_traceback_of_a_process_that_was_well_is_an_error(instance: Instance) -> None:
    (instance.logs / "comms_manager.log").write_text(f"{COMMS}Traceback (most recent call last):\nKeyError: 1\n")
    with LogReader(instance, "comms_manager", level="error") as reader:
        assert texts(reader) == ["Traceback (most recent call last):", "KeyError: 1"]


@given(st.datetimes(datetime(2000, 1, 1), datetime(2100, 1, 1)), st.integers(0, 10**5))
def test_since_means_so_long_ago_or_a_moment(now: datetime, amount: int) -> None:
    assert moment(f"{amount}s", now) == now - timedelta(seconds=amount)
    assert moment(f"{amount}min", now) == now - timedelta(minutes=amount)
    assert moment(f"{now:%Y-%m-%d %H:%M:%S}", now) == now.replace(microsecond=0)
    assert moment(f"{now:%H:%M}", now) == now.replace(second=0, microsecond=0)


def test_what_cannot_be_is_refused(instance: Instance) -> None:
    with pytest.raises(ConfigurationError, match="--since 'yore'"):
        moment("yore", datetime(2026, 1, 1))
    with pytest.raises(ConfigurationError, match="did you mean 'warning'"):
        LogReader(instance, None, level="waning")
    with pytest.raises(ValorError, match="no log of bifrostd"):
        LogReader(instance, "bifrostd")
    assert LEVELS.index("error") > LEVELS.index("warning")


def test_a_line_on_a_pipe_is_plain_and_names_its_service(
    instance: Instance, capsys: pytest.CaptureFixture[str]
) -> None:
    with LogReader(instance, None) as reader:
        LogView(named=True).show(reader.take())
    shown = capsys.readouterr().out.splitlines()
    assert shown[2] == "01-31 23:59:58.500 comms_manager        WARNING two"
    assert "\033" not in "".join(shown)
