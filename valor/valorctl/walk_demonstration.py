"""``demo walk``: a system of its own on the course of dirt, one walk, one bag, and the walk in figures and pictures."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

from valor.common import worlds
from valor.common.errors import ValorError
from valor.common.instance import ClockMode, Instance
from valor.common.robot import RobotDescription
from valor.common.worlds.dirt import Dirt
from valor.valorctl import demonstration, walking
from valor.valorctl.console import Progress, bar, say_rows
from valor.valorctl.instance_setup import Request
from valor.valorctl.interruption import InterruptedBySignalError, Interruption

NAME = "demo-walk"
WORLD = "dirt"
SPEED = 0.4  # unless another is asked for [m/s]

_BAG, _FIGURES = "walk.mcap", "walk.json"


def course() -> float:
    """From the start to the finish line [m]."""
    world = worlds.WORLDS[WORLD]
    assert isinstance(world, Dirt)
    return world.course


@dataclass(frozen=True)
class Course:
    """What is to be walked, and how time runs meanwhile."""

    distance: float  # [m]
    speed: float  # [m/s]
    seed: int
    clock: ClockMode
    real_time_factor: float


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
    order = walking.Order(forward=wanted.speed, distance=wanted.distance, straight=True)
    bag, figures = demonstration.prepare(out, _BAG, _FIGURES)
    request = Request(
        actuators="hardware", world=WORLD, seed=wanted.seed, clock=wanted.clock,
        real_time_factor=wanted.real_time_factor, bag=bag,
    )  # fmt: skip
    failure: ValorError | None = None
    with demonstration.running(instance, request, progress, interruption) as settings:
        try:
            with bar("walking", wanted.distance, "m") as at:
                walk = walking.walk(instance, order, interruption.check, lambda _, way: at(way))
            progress.done(f"walked {walk.describe()}")
            if walk.reason:
                failure = ValorError(f"walked {walk.describe()}, then {walk.reason}")
        except InterruptedBySignalError:
            raise
        except ValorError as error:
            failure = error  # figures and pictures may show why
    try:
        made = _show(bag, figures, RobotDescription.load(settings.robot), progress, interruption)
    except ValorError as error:
        raise failure or error from None
    demonstration.tell([bag, figures, *made], progress)
    if failure:
        raise failure


def _show(
    bag: Path, figures_file: Path, robot: RobotDescription, progress: Progress, interruption: Interruption
) -> list[Path]:
    """Figures and pictures, from the bag alone."""
    os.environ.setdefault("MUJOCO_GL", "egl")
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
    interruption.check()
    made: list[Path] = []
    for draw in (walk_plots.path, walk_plots.dynamics, walk_plots.picture):
        progress.waiting(f"drawing the {draw.__name__}")
        made += draw(recorded, robot, out=figures_file.parent)
        interruption.check()
    progress.clear()
    say_rows(
        [
            ("distance", f"{figures.distance:.1f} m"),
            ("robot time", f"{figures.duration:.1f} s ({figures.speed:.2f} m/s)"),
            ("falls", str(int(figures.fell))),
            *report.rows(),
        ]
    )
    return made
