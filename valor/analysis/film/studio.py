"""Frames drawn in several processes at once: most of a film's work, and OpenGL without a GPU draws on one core.

Each draws every so-many-th picture, and waits with it until it is fetched: no more pictures are held than there are
processes, and a process whose parent is gone has nobody to send to, and ends.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

from valor.analysis.film import captions
from valor.analysis.film.frames import Frame
from valor.common.errors import ValorError
from valor.drawing.errors import RenderingError
from valor.drawing.offscreen import Image
from valor.drawing.scene import Quality, Scene
from valor.robot.description import RobotDescription

MOST = 8  # processes; each holds the scene


@dataclass(frozen=True)
class Set:
    """What all pictures have in common.

    Attributes:
        robot: its folder.
        world: its name and seed.
        size: width and height [pixels].
        quality: of each picture.
        begin: recording's time of robot time 0, from which the captions count [s]; None: no captions.
        speed: of the film, for the captions.
    """

    robot: Path
    world: tuple[str, int]
    size: tuple[int, int]
    quality: Quality
    origin: float | None
    speed: float


def draw(stage: Set, frames: list[Frame]) -> Generator[Image, None, None]:
    """The pictures, (height, width, 3) each, in order.

    Raises:
        RenderingError: there is no off-screen OpenGL here.
        ValorError: robot or world cannot be loaded.
    """
    count = max(1, min(len(os.sched_getaffinity(0)), MOST, len(frames)))
    context = get_context("spawn")  # a fork would share OpenGL's and BLAS' state
    with contextlib.ExitStack() as stack, _environment():
        ends: list[Connection] = []
        for number in range(count):
            here, there = context.Pipe(duplex=False)
            worker = context.Process(target=_work, args=(there, stage, frames[number::count]), daemon=True)
            worker.start()
            there.close()
            stack.callback(worker.join)
            stack.callback(here.close)
            ends.append(here)
        for i in range(len(frames)):
            yield _fetch(ends[i % count])


def _fetch(end: Connection) -> Image:
    try:
        found = end.recv()
    except EOFError:
        raise RenderingError("a process that draws ended before its time") from None
    if isinstance(found, ValorError):
        raise found
    image: Image = found
    return image


@contextlib.contextmanager
def _environment() -> Iterator[None]:
    """Processes that are started inside draw on one core each, where OpenGL draws on the CPU."""
    wanted = {"LP_NUM_THREADS": "0", "OPENBLAS_NUM_THREADS": "1"}
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _work(end: Connection, stage: Set, frames: list[Frame]) -> None:
    for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(signum, signal.SIG_IGN)  # of the terminal: the parent decides
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):
        try:
            for image in _draw(stage, frames):
                end.send(image)
        except ValorError as error:
            end.send(type(error)(str(error)))


def _draw(stage: Set, frames: list[Frame]) -> Iterator[Image]:
    robot = RobotDescription.load(stage.robot)
    with closing(Scene(robot, *stage.size, *stage.world, quality=stage.quality)) as scene:
        for frame in frames:
            view = frame.view
            scene.look_at(view.point, view.azimuth, view.elevation, view.distance)
            image = scene.draw(frame.posture, frame.marks)
            if stage.origin is not None:
                time = frame.posture.time - stage.origin
                image = captions.write(image, frame.posture.behavior, time, stage.speed)
            yield image
