"""Results of experiments, the page made of them, and the statistics of processes."""

from __future__ import annotations

import base64
import os
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import psutil
import pytest
from PIL import Image

from harness import analysis_bag
from harness.places import REPOSITORY, ROBOTS
from valor.analysis import chapters, report, report_html, report_markdown, report_pdf
from valor.analysis.bag import Bag
from valor.analysis.errors import ResultError, SignalError
from valor.analysis.joint_signals import JointSignals, draw, neck
from valor.analysis.process_statistics import Sampler, Usage, plot, write_csv
from valor.analysis.recording import Recording
from valor.analysis.results import FAILURE_FILE, FILE, Failure, Measure, Picture, Result, Table, host_facts
from valor.analysis.style import figure, save
from valor.analysis.timeline import Motion, Timeline
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


class Listed(NamedTuple):
    """An experiment as the table names it."""

    name: str
    title: str = "Something"
    reproduces: str = "Figure 9.9"


def collect(folder: Path, *names: str) -> list[chapters.Chapter]:
    return chapters.collect(folder, [Listed(name) for name in names])


class Page(HTMLParser):
    """What a page holds."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.open: list[str] = []
        self.images: list[bytes] = []
        self.links: list[str] = []
        self.outside: list[str] = []
        self.text = ""
        self.feed(file.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {key: value or "" for key, value in attrs}
        if tag not in {"meta", "img"}:
            self.open.append(tag)
        if tag == "img":
            kind, data = values["src"].split(",", 1)
            assert kind == "data:image/png;base64"
            self.images.append(base64.b64decode(data))
        target = values.get("href", "")
        (self.links if target.startswith("#") else self.outside).extend([target] if target else [])

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_a_page_holds_all_and_needs_no_other_file(tmp_path: Path) -> None:
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        save(figure(2.0, 1.0), folder / "a.png")
        made = result(name, [Picture("a.png", "A <picture>.", "Figure 5.1")])
        assert Result.load(made.save(folder).parent) == made
    found = collect(tmp_path, "two", "absent", "one")
    assert [each.result is not None for each in found] == [True, False, True]
    page = Page(report_html.write(found, tmp_path / "out" / "report.html"))
    assert page.open == []
    assert page.outside == []
    assert page.links == ["#two", "#absent", "#one"]
    assert page.images == [(tmp_path / "one" / "a.png").read_bytes()] * 2
    for words in ("What <one> costs", "Done & said.", "12.3", "A <picture>.", "Figure 5.1", "valorctl experiment two",
                  "Not run: there is no folder", "valorctl experiment all"):  # fmt: skip
        assert words in page.text


def test_paper_holds_the_same(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        save(figure(4.0, 3.0), tmp_path / name / "a.png")
        text = Table("Words", ["", "how"], [["x", "as long as it takes, → and more"]])
        made = result(name, [Picture("a.png", "A <picture>.", "Figure 5.1")])
        msgspec.structs.replace(made, tables=[*made.tables, text]).save(tmp_path / name)
    content = report_pdf.write(collect(tmp_path, "one", "two"), tmp_path / "out" / "report.pdf").read_bytes()
    assert content.startswith(b"%PDF-")
    assert content.count(b"/Type /Page\n") >= 2
    assert content.count(b"/Subtype /Image") >= 1
    assert content.count(b"/Title") >= 3  # of the document and of both experiments
    (tmp_path / "one" / "a.png").write_bytes((tmp_path / "two" / "a.png").read_bytes()[:20])
    for write, place in ((report_pdf.write, "report.pdf"), (report_markdown.write, "page")):
        with pytest.raises(ResultError, match=r"one/a\.png: not a picture"):
            write(collect(tmp_path, "one"), tmp_path / place)


def test_a_repository_gets_a_page_with_its_figures_beside_it(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    save(figure(2.0, 1.0), tmp_path / "one" / "a.png")
    result("one", [Picture("a.png", "A *picture*.", "Figure 5.1")]).save(tmp_path / "one")
    page = report_markdown.write(collect(tmp_path, "one", "absent"), tmp_path / "out")
    text = page.read_text()
    assert "![A \\*picture\\*.](a.webp)" in text
    with Image.open(tmp_path / "one" / "a.png") as drawn, Image.open(tmp_path / "out" / "a.webp") as copied:
        assert copied.format == "WEBP"
        assert copied.tobytes() == drawn.convert("RGB").tobytes()
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["README.md", "a.webp"]
    assert "| a | 12.3 | ms | 40 | slower |" in text
    assert "| name | value |\n| --- | --: |\n| x | 1 |" in text
    assert "\n    valorctl experiment all\n" in text
    assert "load" in text  # how busy the computer was
    assert "**Not run: there is no folder" in text
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultError, match="file"):
        report_markdown.write(collect(tmp_path, "one"), tmp_path / "file")


def test_columns_of_words_begin_at_the_left() -> None:
    table = Table("", ["", "a", "b"], [["row", "12.3", "-"], ["row", "–", "by cross-correlation"]])
    assert [table.is_text(i) for i in range(3)] == [True, False, True]


def test_what_failed_or_is_broken_is_told_in_its_place_and_costs_no_other(tmp_path: Path) -> None:
    for name in ("fine", "failed", "unfinished", "broken", "faded"):
        (tmp_path / name).mkdir()
    save(figure(2.0, 1.0), tmp_path / "fine" / "a.png")
    result("fine", [Picture("a.png", "A picture.")]).save(tmp_path / "fine")
    Failure(
        experiment="failed", command="valorctl experiment failed", started="then", reason="the arm <fell> off"
    ).save(tmp_path / "failed")
    (tmp_path / "broken" / FILE).write_text('{"experiment": 1}')
    (tmp_path / "faded" / "b.png").write_text("no picture")
    result("faded", [Picture("gone.png", "Gone."), Picture("b.png", "Faded.")]).save(tmp_path / "faded")
    found = collect(tmp_path, "failed", "unfinished", "fine", "broken", "faded", "absent")
    told = {
        "failed": "failed: the arm <fell> off",
        "unfinished": f"Not finished: {tmp_path / 'unfinished'} has no result.json",
        "broken": "Its result cannot be read",
        "faded": f"Not shown: {tmp_path / 'faded' / 'gone.png'}: No such file",
        "absent": f"there is no folder {tmp_path / 'absent'}",
    }
    assert [chapter.name for chapter in found if chapter.broken] == ["failed", "unfinished", "broken", "faded"]
    page = Page(report_html.write(found, tmp_path / "report.html"))
    assert page.open == []
    assert len(page.images) == 1
    markdown = report_markdown.write(found, tmp_path / "out").read_text().replace("\\<", "<")
    for words in (*told.values(), "b.png: not a picture"):
        assert words in page.text
        assert words in markdown
    assert report_pdf.write(found, tmp_path / "report.pdf").stat().st_size > 1000


def test_a_result_or_failure_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="no results of experiments"):
        collect(tmp_path, "one")
    (tmp_path / FILE).write_text('{"experiment": 1}')
    with pytest.raises(ResultError, match="Expected `str`"):
        Result.load(tmp_path)
    (tmp_path / FAILURE_FILE).write_text("{")
    with pytest.raises(ResultError, match=FAILURE_FILE):
        Failure.load(tmp_path)


def test_processes_are_measured_as_busy_as_they_are(tmp_path: Path) -> None:
    programs = {"busy": "while True: pass", "idle": "import time; time.sleep(100)"}
    start = "print(flush=True)\n"  # the interpreter is up
    running = {
        name: subprocess.Popen([sys.executable, "-c", start + text], stdout=subprocess.PIPE)
        for name, text in programs.items()
    }
    looks = 0
    try:
        for process in running.values():
            assert process.stdout is not None
            process.stdout.readline()
        busy = psutil.Process(running["busy"].pid)

        def used() -> float:
            return sum(busy.cpu_times()[:2])

        before = used()
        sampler = Sampler({name: process.pid for name, process in running.items()})
        begun = used()
        while (last := used()) < begun + 0.5:
            time.sleep(0.1)
            sampler.look()
            looks += 1
        ended = used()
    finally:
        for process in running.values():
            process.kill()
            process.wait()
    usage = sampler.usage()
    assert all(len(one.time) == looks for one in usage.values())
    assert 0.0 <= usage["idle"].cpu.mean() < usage["busy"].cpu.mean() <= 130.0
    seconds = usage["busy"].cpu @ np.diff(usage["busy"].time, prepend=0.0) / 100.0
    assert last - begun - 0.2 <= seconds <= ended - before + 0.2  # between two looks it is busy, too
    assert 1.0 < usage["idle"].memory.mean() < 100.0
    rows = write_csv(usage, tmp_path / "usage.csv").read_text().splitlines()
    assert rows[0] == "process,time_s,cpu_percent,memory_mib"
    assert len(rows) == 1 + 2 * looks
    behavior = np.array([0.0, 0.2, 0.4]), np.array(["stand", "stand", "walk"])
    assert plot(usage, behavior, tmp_path / "usage.png").stat().st_size > 10_000
    with pytest.raises(SignalError, match="busy: ended"):
        sampler.look()


def test_a_process_that_does_not_run_is_named() -> None:
    gone = subprocess.Popen(["true"])
    gone.wait()
    with pytest.raises(SignalError, match="gone: no process"):
        Sampler({"self": os.getpid(), "gone": gone.pid})
    assert Usage(*np.zeros((3, 0))).cpu.size == 0


def test_a_joints_signals_from_goal_to_encoder(tmp_path: Path) -> None:
    path = tmp_path / "reach.mcap"
    analysis_bag.write(path, ROBOT)
    recording = Recording(Bag(path), ROBOT)
    goal = {joint: value for joint, value in analysis_bag.GOALS.items() if joint in ROBOT.tables.groups["right_arm"]}
    timeline = Timeline([Motion("reach", 1.0, 3.4, goal), Motion("look", 1.0, 3.4, {"neck_yaw": -0.5})])
    elbow = JointSignals.of(recording, timeline, "r_elbow_pitch")
    assert elbow.response is not None
    assert 0.0 < elbow.response.seconds < 0.3  # the servo follows its command
    assert abs(elbow.final_error(timeline)) < 0.02
    assert 0.001 < elbow.largest_error() < 0.3
    assert np.nanmax(elbow.reference[1]) == goal["r_elbow_pitch"]
    look = JointSignals.of(recording, timeline, "neck_yaw")
    assert draw(recording, [elbow, look], "velocity", "Two", tmp_path / "two.png").stat().st_size > 10_000
    assert neck(recording, look, tmp_path / "neck.png").stat().st_size > 10_000
    with pytest.raises(BagError, match="no motion moved l_elbow_pitch"):
        JointSignals.of(recording, timeline, "l_elbow_pitch")


def test_a_report_begins_with_ten_numbers_that_the_experiments_measure(tmp_path: Path) -> None:
    assert len(report.SUMMARY) == 10
    stored = (REPOSITORY / "docs" / "experiments" / "README.md").read_text()
    assert [name for name in report.SUMMARY if stored.count(f"| {name} |") != 2] == []  # in short, and in its place
    measures = [Measure("else", 1.0, "s"), Measure(report.SUMMARY[1], 73.3, "%", "over 150", "")]
    short = report.summary([None, msgspec.structs.replace(result(), measures=measures)])
    assert [tuple(row) for row in short.rows] == [(report.SUMMARY[1], "73.3", "%", "over 150")]
