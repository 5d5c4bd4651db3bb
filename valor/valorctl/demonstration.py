"""What demonstrations do alike: a system of their own, one bag, pictures of it, and nothing that goes on running."""

from __future__ import annotations

import contextlib
import math
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.robot.description import RobotDescription
from valor.robot.size import narrowness
from valor.simulation import worlds
from valor.simulation.worlds.dirt import Dirt
from valor.valorctl import startup, walking
from valor.valorctl.console import Progress, bar, say
from valor.valorctl.interruption import InterruptedBySignalError, Interruption

WORLD = "dirt"
SPEED = 0.4  # forward, of ESCHER [m/s]

Drawing = tuple[str, Callable[[], list[Path]]]  # what is drawn, and who makes which files


def course() -> float:
    """From the start to the finish line [m]."""
    world = worlds.WORLDS[WORLD]
    assert isinstance(world, Dirt)
    return world.course


def speed(robot: RobotDescription) -> float:
    """Forward, unless another is asked for: at ESCHER's Froude number, on narrow soles slower [m/s]."""
    feet = robot.tables.feet
    narrow = narrowness(robot.tables.size.leg, min(feet.left.half_width, feet.right.half_width))
    return SPEED * math.sqrt(worlds.size_of(robot) * narrow)


class Failures:
    """The first thing that went wrong, kept while all that can still be done is done."""

    def __init__(self) -> None:
        self._first: ValorError | None = None

    @contextlib.contextmanager
    def kept(self) -> Iterator[None]:
        """Keep what is raised inside, unless the user wants to stop."""
        try:
            yield
        except InterruptedBySignalError:
            raise
        except ValorError as error:
            self._first = self._first or error

    def tell(self) -> None:
        """Raise the first, if there was one."""
        if self._first:
            raise self._first


def prepare(instance: Instance, out: Path, *names: str) -> list[Path]:
    """Make the folder for what a demonstration leaves, and remove what an earlier one left under these names.

    Raises:
        ValorError: the instance is up, perhaps with another demonstration that writes there; the folder cannot be
            written.
    """
    startup.refuse_if_up(instance)
    files = [out / name for name in names]
    try:
        out.mkdir(parents=True, exist_ok=True)
        for stale in files:
            stale.unlink(missing_ok=True)
    except OSError as error:
        raise ValorError(f"{error.filename}: {error.strerror}") from None
    return files


def walk(instance: Instance, order: walking.Order, progress: Progress, interruption: Interruption) -> None:
    """Walk a distance, with a bar.

    Raises:
        ValorError: the robot did not get there; says why.
    """
    assert order.distance is not None
    with bar("walking", order.distance, "m") as at:
        walked = walking.walk(instance, order, interruption.check, lambda _, way: at(way))
    if walked.reason:
        raise ValorError(f"walked {walked.describe()}, then {walked.reason}")
    progress.done(f"walked {walked.describe()}")


def draw(drawings: Iterable[Drawing], failures: Failures, progress: Progress, interruption: Interruption) -> list[Path]:
    """Make pictures, from the bag alone; one that fails does not keep the others from being made."""
    made: list[Path] = []
    for what, function in drawings:
        progress.waiting(f"drawing {what}")
        with failures.kept():
            made += function()
        interruption.check()
    return made


def tell(files: Iterable[Path], progress: Progress) -> None:
    """Say which files there are."""
    for file in files:
        if file.exists():
            size = file.stat().st_size
            progress.done(f"{file} ({size / 1e6:.0f} MB)" if size >= 1e6 else f"{file} ({size / 1e3:.0f} kB)")


def require_film(file: Path | None) -> None:
    """Look at the ending of a film's name before anything moves.

    Raises:
        ConfigurationError: it is none of those known.
    """
    if file is not None:
        from valor.analysis.film import files

        files.kind(file)


def film(bag: Path, file: Path | None, failures: Failures, progress: Progress) -> None:
    """Film the whole bag, if a film is wanted."""
    if file is None:
        return
    from valor.analysis.film.film import Order
    from valor.valorctl import filming

    progress.clear()
    with failures.kept():
        filming.shoot(bag, file, Order(overlays=("modes",)))


def suggest(*commands: tuple[str, str]) -> None:
    """Say what to try next: verbs with their arguments, and what they do."""
    program = Path(sys.executable).with_name("valorctl")
    here, found = Path.cwd(), shutil.which("valorctl")
    name = program.relative_to(here) if program.is_relative_to(here) else program
    if found and program.exists() and program.samefile(found):
        name = Path("valorctl")
    width = max(len(command) for command, _ in commands)
    say("\nnext:")
    for command, what in commands:
        say(f"  {name} {command:{width}}  # {what}")
