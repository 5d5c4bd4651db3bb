"""Results of experiments, the report made of them, and the measurements of processes and joints."""

import base64
import html
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import psutil
import pytest
from PIL import Image

from harness import analysis_bag
from harness.places import REPOSITORY, ROBOTS
from tests.thesis import pathway_bag
from thesis.analysis import rates
from thesis.analysis.joint_signals import JointSignals, draw, neck
from thesis.analysis.process_statistics import Sampler, write_csv
from thesis.analysis.timeline import Motion, Timeline
from thesis.errors import ResultError, SignalError
from thesis.report import chapters, page
from thesis.report.document import SUMMARY, conclusion, markdown
from thesis.report.results import FAILURE_FILE, FILE, Failure, Measure, Picture, Result, Table, host_facts
from valor.analysis.reading.bag import Bag
from valor.analysis.reading.recording import Recording
from valor.analysis.style import figure, save
from valor.bags.errors import BagError
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")


def result(name: str = "one", pictures: list[Picture] | None = None) -> Result:
    return Result(
        experiment=name, title="What <one> costs", reproduces="Table 5.1", command=f"valorctl experiment {name}",
        started="2026-01-01T00:00:00+00:00", quick=True, settings={"seed": "3"}, host=host_facts(), text="Done & said.",
        measures=[Measure("a", 12.345, "ms", "40", "slower"), Measure("b", None, "ms")],
        tables=[Table("Rows", ["name", "value"], [["x", "1"], ["y", "2"]])], pictures=pictures or [],
    )  # fmt: skip


def stored(folder: Path, name: str, *, picture: bool = True) -> None:
    (folder / name).mkdir()
    if picture:
        save(figure(2.0, 1.0), folder / name / "a.png")
    result(name, [Picture("a.png", "A *picture*.", "Figure 5.1")]).save(folder / name / FILE)


class Listed(NamedTuple):
    name: str
    title: str = "Something"
    reproduces: str = "Figure 9.9"


def collect(folder: Path, *names: str) -> list[chapters.Chapter]:
    return chapters.collect(folder, [Listed(name) for name in names])


class Page:
    def __init__(self, file: Path) -> None:
        page = file.read_text()
        pictures = re.findall(r'<img src="data:image/webp;base64,([^"]+)"', page)
        self.images = [base64.b64decode(data) for data in pictures]
        self.links = re.findall(r'href="([^"]*)"', page)
        self.anchors = [f"#{name}" for name in re.findall(r'<h2 id="([^"]*)"', page)]
        self.text = html.unescape(re.sub(r"<[^>]*>", "", page))


def test_a_report_is_markdown_with_figures_and_a_page_that_needs_no_other_file(tmp_path: Path) -> None:
    for name in ("one", "two"):
        stored(tmp_path, name)
    assert Result.load(tmp_path / "one" / FILE).experiment == "one"
    found = collect(tmp_path, "two", "absent", "one")
    assert [each.result is not None for each in found] == [True, False, True]
    file, text = page.write(found, tmp_path / "out")
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["README.md", "a.webp", "report.html"]
    with Image.open(tmp_path / "one" / "a.png") as drawn, Image.open(tmp_path / "out" / "a.webp") as copied:
        assert copied.tobytes() == drawn.convert("RGB").tobytes()

    shown = Page(file)
    assert shown.links == shown.anchors and len(shown.anchors) == 3
    assert shown.images == [(tmp_path / "out" / "a.webp").read_bytes()] * 2
    for words in ("What <one> costs", "Done & said.", "12.3", "A *picture*.", "Figure 5.1", "valorctl experiment two",
                  "Not run: there is no folder", "valorctl experiment all", "load"):  # fmt: skip
        assert words in shown.text

    written = text.read_text()
    assert "![A \\*picture\\*.](a.webp)" in written and "| a | 12.3 | ms | 40 | slower |" in written
    assert "| name | value |\n| --- | --: |\n| x | 1 |" in written and "\n    valorctl experiment all\n" in written
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultError, match="file"):
        page.write(found, tmp_path / "file")


def test_a_failed_or_broken_experiment_costs_only_its_own_chapter(tmp_path: Path) -> None:
    stored(tmp_path, "fine")
    for name in ("failed", "unfinished", "broken", "faded"):
        (tmp_path / name).mkdir()
    Failure(
        experiment="failed", command="valorctl experiment failed", started="then", reason="the arm <fell> off"
    ).save(tmp_path / "failed" / FAILURE_FILE)
    (tmp_path / "broken" / FILE).write_text('{"experiment": 1}')
    content = (tmp_path / "fine" / "a.png").read_bytes()
    (tmp_path / "faded" / "b.png").write_bytes(content[:20])
    (tmp_path / "faded" / "c.png").write_bytes(content[:-40])
    result("faded", [Picture(f"{name}.png", "Faded.") for name in ("gone", "b", "c")]).save(tmp_path / "faded" / FILE)
    found = collect(tmp_path, "failed", "unfinished", "fine", "broken", "faded", "absent")
    assert [chapter.name for chapter in found if chapter.broken] == ["failed", "unfinished", "broken", "faded"]
    file, text = page.write(found, tmp_path / "out")
    shown, written = Page(file), text.read_text().replace("\\<", "<")
    assert len(shown.images) == 1
    for words in (
        "failed: the arm <fell> off", f"Not finished: {tmp_path / 'unfinished'} has no result.json",
        "Its result cannot be read", f"Not shown: {tmp_path / 'faded' / 'gone.png'}: No such file",
        "b.png: not a picture", "c.png: not a picture", f"there is no folder {tmp_path / 'absent'}",
    ):  # fmt: skip
        assert words in shown.text and words in written


def test_an_unreadable_result_or_failure_is_named(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="no results of experiments"):
        collect(tmp_path, "one")
    (tmp_path / FILE).write_text('{"experiment": 1}')
    with pytest.raises(ResultError, match="Expected `str`"):
        Result.load(tmp_path / FILE)
    with pytest.raises(ResultError, match=f"{FAILURE_FILE}: No such file"):
        Failure.load(tmp_path / FAILURE_FILE)


def test_a_report_begins_with_numbers_that_the_experiments_measure() -> None:
    assert len(SUMMARY) == 14
    kept = (REPOSITORY / "docs" / "experiments" / "README.md").read_text()
    assert [name for name in SUMMARY if kept.count(f"| {name} |") < 2] == []  # in the summary and in its chapter
    measures = [Measure("else", 1.0, "s"), Measure(SUMMARY[1], 73.3, "%", "over 150", "")]
    made = msgspec.structs.replace(result(), measures=measures)
    text = markdown([chapters.Chapter("one", "One", "Table 5.1", Path(), made)])
    row = f"| in short | here | unit | thesis |\n| --- | --: | --- | --- |\n| {SUMMARY[1]} | 73.3 | % | over 150 |\n"
    assert row in text


def test_what_follows_for_messages_is_computed_and_not_told() -> None:
    measures = [
        Measure("Bifrost, mean", 300.0, "µs", "200"), Measure("ROS 2 (rclpy, Fast DDS), mean", 500.0, "µs", "160"),
        Measure("mode change, hardware", 50.0, "ms", "49"), Measure("proprioception, hardware", 2.5, "ms", "40"),
        Measure("joint command by stamps, hardware", 2.0, "ms"),
    ]  # fmt: skip
    text = conclusion([msgspec.structs.replace(result(), measures=measures)])
    for words in ("200 and 250 times less", "5.0 and 8.3 times less than the shortest (proprioception, hardware)",
                  "0.7 and 0.9 orders", "became 16 times shorter", "1.5 to 3.1 times as long", "by 8 %"):  # fmt: skip
        assert words in text
    assert conclusion([msgspec.structs.replace(result(), measures=measures[1:])]) == ""


def test_rates_are_those_of_the_messages_in_the_bags(tmp_path: Path) -> None:
    pathway_bag.write(tmp_path / "a.mcap", ROBOT)
    came = rates.achieved(tmp_path / "a.mcap")
    assert came == pytest.approx({"control tick": 500.0, "motor commands": 500.0, "joint states": 250.0}, rel=1e-3)
    told = rates.told([came, came | {"joint states": 99.6}, {}])
    assert told == {
        "control tick came at": "500 Hz", "motor commands came at": "500 Hz", "joint states came at": "100–250 Hz",
    }  # fmt: skip


def test_processes_are_measured_as_busy_as_they_are(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", "print(flush=True)\nwhile True: pass"], stdout=subprocess.PIPE
    ) as program:
        assert program.stdout is not None
        program.stdout.readline()
        busy = psutil.Process(program.pid)
        before = sum(busy.cpu_times()[:2])
        sampler = Sampler({"busy": program.pid})
        begun = sum(busy.cpu_times()[:2])
        while (last := sum(busy.cpu_times()[:2])) < begun + 0.5:
            time.sleep(0.1)
            sampler.sample()
        program.kill()
    usage = sampler.usage()["busy"]
    seconds = usage.cpu @ np.diff(usage.time, prepend=0.0) / 100.0
    assert begun - before < 0.5 and last - begun - 0.2 <= seconds <= last - before + 0.2
    assert 1.0 < usage.memory.mean() < 100.0
    rows = write_csv({"busy": usage}, tmp_path / "usage.csv").read_text().splitlines()
    assert rows[0] == "process,time_s,cpu_percent,memory_mib" and len(rows) == 1 + len(usage.time)
    with pytest.raises(SignalError, match="busy: ended"):
        sampler.sample()
    with pytest.raises(SignalError, match="gone: no process"):
        Sampler({"self": os.getpid(), "gone": program.pid})


def test_a_joints_signals_from_goal_to_encoder(tmp_path: Path) -> None:
    path = tmp_path / "reach.mcap"
    analysis_bag.write(path, ROBOT)
    recording = Recording(Bag(path), ROBOT)
    goal = {joint: value for joint, value in analysis_bag.GOALS.items() if joint in ROBOT.tables.groups["right_arm"]}
    timeline = Timeline([Motion("reach", 1.0, 3.4, goal), Motion("look", 1.0, 3.4, {"neck_yaw": -0.5})])
    elbow = JointSignals.of(recording, timeline, "r_elbow_pitch")
    assert elbow.response is not None
    assert 0.0 < elbow.response.seconds < 0.3  # the servo follows its command
    assert abs(elbow.final_error(timeline)) < 0.02 and 0.001 < elbow.largest_error() < 0.3
    assert np.nanmax(elbow.reference[1]) == goal["r_elbow_pitch"]
    look = JointSignals.of(recording, timeline, "neck_yaw")
    assert draw(recording, [elbow, look], "velocity", "Two", tmp_path / "two.png").stat().st_size > 10_000
    assert neck(recording, look, tmp_path / "neck.png").stat().st_size > 10_000
    with pytest.raises(BagError, match="no motion moved l_elbow_pitch"):
        JointSignals.of(recording, timeline, "l_elbow_pitch")
