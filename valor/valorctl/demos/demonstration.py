"""Demonstrations: each starts a simulated system, performs the steps of its row in ``DEMOS``, and shuts it down.

A demonstration leaves one bag, measurements and pictures in its folder.
"""

import contextlib
import math
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.robot.description import RobotDescription
from valor.robot.size import narrowness
from valor.simulation import worlds
from valor.simulation.worlds.courses import Dirt
from valor.valorctl.drive import walking
from valor.valorctl.instance import instance_setup, startup
from valor.valorctl.terminal.console import InterruptedBySignalError, Interruption, Progress, bar, say

WORLD = "dirt"
SPEED = 0.4  # forward, of ESCHER [m/s]


@dataclass(frozen=True)
class DemoOptions:
    """Options of the verbs."""

    out: Path  # folder of the results
    request: instance_setup.Request  # without world and bag
    distance: float | None = None  # `demo walk` [m]; None: to the finish line
    speed: float | None = None  # `demo walk` [m/s]; None: by the robot's size
    blocked: bool = False  # `demo door`, `demo valve`: the fixture does not move

    @property
    def seed(self) -> int:
        """Seed of world and noise."""
        return self.request.seed or 0


@dataclass
class Context:
    """What the steps of a demonstration use."""

    instance: Instance
    robot: RobotDescription
    options: DemoOptions
    bag: Path
    report: Path
    progress: Progress
    interruption: Interruption

    def walk(self, request: walking.WalkRequest) -> None:
        """Walk a distance, with a progress bar; raises ``ValorError`` with the reason if it is not completed."""
        assert request.distance is not None
        with bar("walking", request.distance, "m") as at:
            walked = walking.walk(self.instance, request, self.interruption.check, lambda _, way: at(way))
        if walked.failure:
            raise ValorError(walked.failure)
        self.progress.done(f"walked {walked.describe()}")


Step = Callable[[Context], object]
Picture = tuple[str, Callable[[], list[Path]]]  # what is drawn, and the function that returns the files


@dataclass(frozen=True)
class Demo:
    """A row of the table of demonstrations."""

    world: str  # of the simulation
    files: tuple[str, str]  # names of bag and report
    check: Step  # raises ``ValorError`` before the start if the robot cannot do it
    steps: Sequence[Step]  # performed in order, in the running system
    pictures: Callable[[Context], Sequence[Picture]] = lambda _: ()  # drawn after shutdown, from the bag
    suggestions: Sequence[tuple[str, str]] = ()  # commands to try next, and what they do
    blocked_world: str = ""  # with ``DemoOptions.blocked``


def course() -> float:
    """Distance from the start to the finish line of the dirt course [m]."""
    world = worlds.WORLDS[WORLD]
    assert isinstance(world, Dirt)
    return world.course


def speed(robot: RobotDescription) -> float:
    """Default speed: at ESCHER's Froude number, lower for narrow soles [m/s]."""
    feet = robot.tables.feet
    narrow = narrowness(robot.tables.size.leg, min(feet.left.half_width, feet.right.half_width))
    return SPEED * math.sqrt(worlds.size_of(robot) * narrow)


def run(instance: Instance, demo: Demo, options: DemoOptions, progress: Progress, interruption: Interruption) -> None:
    """Run a demonstration and list its files; raises ``ValorError`` with the part that failed."""
    robot = RobotDescription.load(instance_setup.plan(options.request).settings.robot)
    bag, report = (options.out / name for name in demo.files)
    context = Context(instance, robot, options, bag, report, progress, interruption)
    demo.check(context)
    prepare(instance, options.out, bag, report)
    world = demo.blocked_world if options.blocked else demo.world
    request = replace(options.request, world=world, bag=bag)
    failures = Failures()
    with startup.running(instance, request, progress, interruption), failures.kept():
        for step in demo.steps:
            step(context)
    made: list[Path] = []
    with failures.kept():
        made = draw(demo.pictures(context), failures, progress, interruption)
    list_files([bag, report, *made], progress)
    failures.raise_first()
    if demo.suggestions:
        suggest(*demo.suggestions)


class Failures:
    """First failure of a demonstration, raised after everything else has been tried."""

    def __init__(self) -> None:
        self._first: ValorError | None = None

    @contextlib.contextmanager
    def kept(self) -> Iterator[None]:
        """Store an error raised inside, unless the user interrupts."""
        try:
            yield
        except InterruptedBySignalError:
            raise
        except ValorError as error:
            self._first = self._first or error

    def raise_first(self) -> None:
        """Raise the first error, if any."""
        if self._first:
            raise self._first


def prepare(instance: Instance, out: Path, *files: Path) -> None:
    """Make the folder of the results and remove earlier ones; raises ``ValorError`` if the instance is up."""
    startup.require_down(instance)
    try:
        out.mkdir(parents=True, exist_ok=True)
        for stale in files:
            stale.unlink(missing_ok=True)
    except OSError as error:
        raise ValorError(f"{error.filename}: {error.strerror}") from None


def draw(pictures: Sequence[Picture], failures: Failures, progress: Progress, interruption: Interruption) -> list[Path]:
    """Draw pictures; the failure of one does not prevent the others."""
    made: list[Path] = []
    for what, function in pictures:
        progress.waiting(f"drawing {what}")
        with failures.kept():
            made += function()
        interruption.check()
    return made


def list_files(files: Sequence[Path], progress: Progress) -> None:
    """List existing files with their sizes."""
    for file in files:
        if file.exists():
            size = file.stat().st_size
            progress.done(f"{file} ({size / 1e6:.0f} MB)" if size >= 1e6 else f"{file} ({size / 1e3:.0f} kB)")


def suggest(*commands: tuple[str, str]) -> None:
    """Print commands to try next: arguments of valorctl, and what they do."""
    program, found = Path(sys.executable).with_name("valorctl"), shutil.which("valorctl")
    name = program.relative_to(Path.cwd()) if program.is_relative_to(Path.cwd()) else program
    if found and program.exists() and program.samefile(found):
        name = Path("valorctl")
    width = max(len(command) for command, _ in commands)
    say("\nnext:")
    for command, what in commands:
        say(f"  {name} {command:{width}}  # {what}")
