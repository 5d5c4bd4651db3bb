"""Logs of several processes, merged by time, filtered by time and level, and followed."""

from datetime import datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance
from valor.valorctl.status.log_reader import LogReader, moment

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


def test_lines_are_ordered_by_time_across_midnight(instance: Instance) -> None:
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


def test_rotated_files_are_read_if_needed(instance: Instance) -> None:
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
    with LogReader(instance, None, datetime(2026, 1, 31, 23, 59, 56)) as reader:
        assert texts(reader)[:4] == ["old", "a library that knows no time", "one", "two"]
    comms.with_name("comms_manager.log.1").unlink()
    comms.with_name("comms_manager.log.1").mkdir()  # who reads it fails
    with LogReader(instance, "comms_manager", level="warning", lines=1) as reader:
        assert texts(reader) == ["two"]


def test_since_and_level_filter_lines(instance: Instance) -> None:
    with LogReader(instance, None, datetime(2026, 1, 31, 23, 59, 59)) as reader:
        assert texts(reader) == ["three", *TRACE, "four", "five"]
    with LogReader(instance, None, level="warning") as reader:
        assert texts(reader) == ["two", "three", *TRACE]
    with LogReader(instance, "comms_manager", level="error") as reader:
        assert texts(reader) == []
    (instance.logs / "comms_manager.log").write_text(f"{COMMS}Traceback (most recent call last):\nKeyError: 1\n")
    with LogReader(instance, "comms_manager", level="error") as reader:
        assert texts(reader) == ["Traceback (most recent call last):", "KeyError: 1"]


@given(st.datetimes(datetime(2000, 1, 1), datetime(2100, 1, 1)), st.integers(0, 10**5))
def test_since_is_an_age_or_a_time(now: datetime, amount: int) -> None:
    assert moment(f"{amount}s", now) == now - timedelta(seconds=amount)
    assert moment(f"{amount}min", now) == now - timedelta(minutes=amount)
    assert moment(f"{now:%Y-%m-%d %H:%M:%S}", now) == now.replace(microsecond=0)
    assert moment(f"{now:%H:%M}", now) == now.replace(second=0, microsecond=0)


def test_invalid_arguments_are_rejected(instance: Instance) -> None:
    with pytest.raises(ConfigurationError, match="--since 'yore'"):
        moment("yore", datetime(2026, 1, 1))
    with pytest.raises(ConfigurationError, match="did you mean 'warning'"):
        LogReader(instance, None, level="waning")
    with pytest.raises(ValorError, match="no log of bifrostd"):
        LogReader(instance, "bifrostd")
