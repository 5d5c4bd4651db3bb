"""``bag list``, ``keep``, ``prune`` and ``info`` of a folder, and what is told of recordings."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from harness.places import ROBOTS
from tests.unit.test_recordings import DAY1, DAY2, DAY3, record
from valor.bag_recorder.bag import Bag
from valor.bags import recordings
from valor.common.bounds import UNBOUNDED, Bounds
from valor.common.instance import Instance, Recording, Settings
from valor.valorctl import recording_report
from valor.valorctl.app import app
from valor.valorctl.checks import CHECKS


@pytest.fixture
def instance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Instance:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    monkeypatch.delenv("VALOR_INSTANCE", raising=False)
    monkeypatch.delenv("VALOR_BAG_BOUND", raising=False)
    made = Instance("default", tmp_path)
    made.bags.mkdir(parents=True)
    return made


def ctl(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["bag", *arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def up(instance: Instance, **changes: object) -> Settings:
    """What `up` leaves behind, as far as these functions look at it."""
    settings = msgspec.structs.replace(Settings(robot=ROBOTS / "escher", ros_domain_id=1), **changes)
    instance.settings_file.write_text(settings.json())
    return settings


def test_recordings_are_listed_kept_and_pruned(instance: Instance) -> None:
    record(instance.bags, DAY1, pieces=2)
    record(instance.bags, DAY2 + "_fall")
    record(Instance("other", instance.folder.parent).bags, DAY3)
    listed = json.loads(ctl("list", "--json"))
    assert [(row["name"], row["kept"], row["written"]) for row in listed] == [
        (DAY1, False, False), (DAY2 + "_fall", False, False)
    ]  # fmt: skip
    assert listed[0]["size"] > 6 << 20 and listed[0]["duration"] == 1.0 and listed[0]["instance"] == "default"
    assert {row["name"] for row in json.loads(ctl("list", "--all", "--json"))} == {DAY1, DAY2 + "_fall", DAY3}

    assert "stays" in ctl("keep", DAY1)
    assert "kept" in ctl("list")
    ctl("keep", DAY1, "--undo")
    assert "kept" not in ctl("list")
    assert ctl("keep", str(instance.bags / DAY1 / "any piece")) == f"{DAY1} stays\n"
    bounds = ("--bag-bound", "9MB", "--bag-bound", "9999d")
    told = ctl("prune", "--dry-run", *bounds)
    assert f"{DAY2}_fall.mcap: 3.1 MB, more than 9 MB in all" in told and "3.1 MB would be freed" in told
    assert len(json.loads(ctl("list", "--json"))) == 2
    assert "3.1 MB freed; recordings take 6.3 MB" in ctl("prune", *bounds)
    ctl("keep", str(instance.bags / DAY1), "--undo")
    recordings.save_bounds(instance.bags, Bounds(age=None, size=8 << 20, share=None))
    assert "0.0 MB freed" in ctl("prune"), "within those of the last `up`"
    assert "6.3 MB freed; recordings take 0.0 MB" in ctl("prune", "--bag-bound", "60s")
    assert ctl("list").strip() == "no recordings"


def test_info_looks_into_folders_and_goes_on_after_what_it_cannot_read(instance: Instance) -> None:
    record(instance.bags, DAY1, pieces=2)
    record(instance.bags, DAY2)
    unfinished = instance.bags / DAY3 / f"{DAY3}.mcap"
    unfinished.parent.mkdir()
    bag = Bag(unfinished)
    lines = ctl("info", str(instance.folder)).splitlines()
    assert [line.split(":")[0] for line in lines] == [str(instance.bags / DAY1), str(instance.bags / DAY2)]
    assert "6.3 MB, 1.0 s, 2 messages" in lines[0]
    assert len(json.loads(ctl("info", str(instance.bags), "--json"))) == 2
    assert "/words" in ctl("info", DAY1), "by its name"
    bag.abandon()


def test_what_is_recorded_now_and_until_when(instance: Instance) -> None:
    settings = up(instance)
    record(instance.bags, DAY1)
    bounds = Bounds(size=20_000_000, share=None)
    ahead = recording_report.outlook(instance, bounds, None)
    taken = recordings.look(instance.bags)[0].size
    assert ahead.seconds == pytest.approx((20e6 - taken) / recording_report.USUAL_RATE) and not ahead.short
    assert ahead.line() == "1.0 MB/s, in 17 s recordings take 20.0 MB and the oldest go"
    ahead = recording_report.outlook(instance, UNBOUNDED, None)
    assert ahead.short and 0 < ahead.seconds < ahead.free / recording_report.USUAL_RATE
    ahead = recording_report.outlook(instance, bounds, instance.folder.parent / "mine.mcap")
    assert not ahead.bounded and ahead.line().endswith("the disk is full")
    assert (
        recording_report.glance(instance, bounds).line()
        == "nothing is being written; recordings take 3.1 MB of 20.0 MB"
    )
    assert "status" in recording_report.announcement(instance, settings, ["bag_recorder"])
    assert recording_report.announcement(instance, settings, ["bifrostd"]) == "nothing is recorded"
    ring = up(instance, recording=Recording(ring_seconds=30.0))
    assert "holding the last 30 s" in recording_report.announcement(instance, ring, ["bag_recorder"])


def test_doctor_warns_before_the_disk_does(instance: Instance) -> None:
    (check,) = (check for check in CHECKS if check.__name__ == "_disk")
    free = recordings.disk_of(instance.bags).free
    levels = {}
    for size in (10 << 20, 2 * free):
        recordings.save_bounds(instance.bags, Bounds(age=None, size=size, share=None))
        found = check(instance)
        levels[size] = found.level
    assert levels == {10 << 20: "ok" if free > 3 << 30 else "warn", 2 * free: "warn"}
    assert "are free and the oldest go" in found.text and f"{2 * free / 1e9:.1f} GB" in found.advice
    (instance.bags / "bounds.json").write_text("{")
    assert check(instance).level == "fail"


def test_down_tells_what_was_recorded_since_up_and_nothing_else(instance: Instance, tmp_path: Path) -> None:
    record(instance.bags, DAY1)
    named = tmp_path / "mine.mcap"
    up(instance, bag=named)
    since = recording_report.up_since(instance)
    bag = Bag(named)
    bag.close()
    instance.settings_file.unlink()
    assert [written.path for written in since()] == [named]
    assert since()[0].line() == f"recorded {named}: 0.0 MB, 0 s"
    assert recording_report.up_since(instance)() == [], "not up"

    up(instance)
    since = recording_report.up_since(instance)
    name = recordings.name_of(datetime.now())
    record(instance.bags, name, pieces=2)
    (written,) = since()
    assert (written.path.name, written.duration) == (name, 1.0) and written.size > 6 << 20
