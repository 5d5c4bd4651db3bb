"""``demo walk``: a system of its own on the course of dirt, one walk, one bag, and the walk in figures and pictures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from valor.common.instance import ClockMode, Instance
from valor.robot.description import RobotDescription
from valor.valorctl import demonstration, instance_setup, startup, walking
from valor.valorctl.console import Progress, say_rows
from valor.valorctl.instance_setup import Request
from valor.valorctl.interruption import Interruption

NAME = "demo-walk"

_BAG, _FIGURES = "walk.mcap", "walk.json"


@dataclass(frozen=True)
class Course:
    """What is to be walked, by whom, and how time runs meanwhile."""

    robot: str | None  # a name of ``robots/``, or a folder; None: the profile's
    distance: float  # [m]
    speed: float | None  # [m/s]; None: by the robot's size
    seed: int
    clock: ClockMode
    real_time_factor: float
    video: Path | None  # where its film goes; None: none is made


def run(instance: Instance, wanted: Course, out: Path, progress: Progress, interruption: Interruption) -> None:
    """Walk, and tell how it went. Nothing goes on running behind it.

    Args:
        instance: of the demonstration's own.
        wanted: the course.
        out: the folder for what it leaves.
        progress: told how it goes on.
        interruption: ends it early.

    Raises:
        ValorError: the robot did not get there, or a part failed; says which.
    """
    demonstration.require_film(wanted.video)
    robot = RobotDescription.load(instance_setup.plan(Request(robot=wanted.robot)).settings.robot)
    speed = demonstration.speed(robot) if wanted.speed is None else wanted.speed
    order = walking.Order(forward=speed, distance=wanted.distance, straight=True)
    bag, figures = demonstration.prepare(instance, out, _BAG, _FIGURES)
    request = Request(
        robot=wanted.robot, actuators="hardware", world=demonstration.WORLD, seed=wanted.seed, clock=wanted.clock,
        real_time_factor=wanted.real_time_factor, bag=bag,
    )  # fmt: skip
    failures = demonstration.Failures()
    with startup.running(instance, request, progress, interruption) as settings, failures.kept():
        demonstration.walk(instance, order, progress, interruption)
    made: list[Path] = []
    with failures.kept():
        drawings = _evaluate(bag, figures, RobotDescription.load(settings.robot), progress)
        made = demonstration.draw(drawings, failures, progress, interruption)
    demonstration.tell([bag, figures, *made], progress)
    demonstration.film(bag, wanted.video, failures, progress)
    failures.tell()


def _evaluate(
    bag: Path, figures_file: Path, robot: RobotDescription, progress: Progress
) -> list[demonstration.Drawing]:
    """Figures, from the bag alone; returns what is to be drawn."""
    from valor.analysis import walk_plots
    from valor.analysis.bag import Bag
    from valor.analysis.recording import Recording
    from valor.analysis.walk import Figures, Timeliness, Track
    from valor.analysis.walk_report import WalkReport

    progress.waiting("reading the bag")
    recorded = Bag.of(bag)
    recording = Recording(recorded, robot)
    track = Track.of(recording)
    track = track.between(*track.walk())
    figures = Figures.of(track)
    report = WalkReport(figures, Timeliness.of(recording, track))
    whole = {"distance_m": figures.distance, "duration_s": figures.duration, "fell": figures.fell}
    figures_file.write_text(json.dumps(whole | report.named(), indent=2) + "\n")
    progress.clear()
    say_rows(
        [
            ("distance", f"{figures.distance:.1f} m"),
            ("robot time", f"{figures.duration:.1f} s ({figures.speed:.2f} m/s)"),
            ("falls", str(int(figures.fell))),
            *report.rows(),
        ]
    )
    return [
        (f"the {draw.__name__}", partial(draw, recorded, robot, figures_file.parent))
        for draw in (walk_plots.path, walk_plots.dynamics, walk_plots.picture)
    ]
