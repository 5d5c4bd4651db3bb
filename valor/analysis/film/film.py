"""A bag's film: read, planned, drawn, written."""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from valor.analysis.film import files, frames, moments, studio
from valor.analysis.film.cameras import CAMERAS
from valor.analysis.film.moments import Moments
from valor.bags.errors import BagError
from valor.bags.origin import origin_of, robot_of
from valor.common.errors import ConfigurationError, require_one_of
from valor.drawing.scene import MOVING, SMALL, STILL
from valor.robot.description import RobotDescription
from valor.simulation import worlds

OVERLAYS = (*frames.OVERLAYS, frames.MODES)
_SMALL = 800  # width up to which pictures are small [pixels]
SMALLEST, LARGEST = 64, 3840  # a side of the picture [pixels]


@dataclass(frozen=True)
class Order:
    """What film is wanted.

    Attributes:
        begin, end: of it, after the recording's beginning [s]; an end of None is the recording's.
        camera: one of ``CAMERAS``.
        speed: recording's time in a second of the film's.
        overlays: some of ``OVERLAYS``.
        size: width and height [pixels]; None: as the kind of file has it, 16 : 9.
        rate: pictures a second; None: as the kind of file has it.
        robot: its folder; None: as the recording says.
        fine: every picture drawn as if it were to stand still.

    Raises:
        ConfigurationError: by the constructor: something in it cannot be; names it, and what is expected.
    """

    begin: float = 0.0
    end: float | None = None
    camera: str = "follow"
    speed: float = 1.0
    overlays: Collection[str] = ()
    size: tuple[int, int] | None = None
    rate: float | None = None
    robot: Path | None = None
    fine: bool = False

    def __post_init__(self) -> None:
        require_one_of("camera", self.camera, CAMERAS)
        for overlay in self.overlays:
            require_one_of("overlay", overlay, OVERLAYS)
        if self.begin < 0.0:
            raise ConfigurationError(f"from {self.begin:g} s: expected seconds after the recording's beginning")
        if self.end is not None and self.end <= self.begin:
            raise ConfigurationError(f"from {self.begin:g} to {self.end:g} s: an empty span; expected an end behind")
        if not 0.01 <= self.speed <= 100.0:
            raise ConfigurationError(f"speed {self.speed:g}: expected 0.01 to 100 times the robot's")
        if self.rate is not None and not 1.0 <= self.rate <= 120.0:
            raise ConfigurationError(f"{self.rate:g} pictures a second: expected 1 to 120")
        if self.size and not all(SMALLEST <= side <= LARGEST and side % 2 == 0 for side in self.size):
            wrong = "×".join(map(str, self.size))
            raise ConfigurationError(f"size {wrong}: expected even sides of {SMALLEST} to {LARGEST} pixels")

    def step(self, file: Path) -> float:
        """Robot time between two pictures of a file [s].

        Raises:
            ConfigurationError: its ending is none of those known.
        """
        return self.speed / (self.rate or files.kind(file).rate)


@dataclass(frozen=True)
class Subject:
    """Whom a film shows, and where: the robot's folder; name and seed of the world."""

    robot: Path
    world: tuple[str, int]


@dataclass(frozen=True)
class Film:
    """What was made: ``pictures`` in ``duration`` [s], its robot placed by ``base``, ``notices`` of the bag."""

    file: Path
    pictures: int
    duration: float
    base: str
    notices: list[str]


def make(
    bag: Path,
    file: Path,
    order: Order,
    read: Callable[[float], None] = lambda seconds: None,
    drawn: Callable[[int, int], None] = lambda pictures, whole: None,
) -> Film:
    """Make a film of a recording.

    Args:
        bag: the recording.
        file: where the film goes; its ending says of which kind it is.
        order: what is wanted.
        read: called with how far the recording has been read [s]; may raise.
        drawn: called with how many pictures are done, and of how many; may raise. Nothing is left then.

    Returns:
        What was made.

    Raises:
        BagError: the bag is none, lacks what is needed, or ends before the film begins.
        ConfigurationError: ending, robot or world are not known.
        RenderingError: there is no off-screen OpenGL here.
        ValorError: the file cannot be written.
    """
    origin = origin_of(bag)
    world = origin.get("world", "flat"), int(origin.get("seed", "0"))
    subject = Subject(order.robot or robot_of(bag, origin), world)
    found = moments.read(bag, order.begin, order.end, order.step(file), read)
    try:
        return develop(found, subject, file, order, drawn)
    except BagError as error:
        raise BagError(f"{bag}: {error}") from None


def develop(
    found: Moments,
    subject: Subject,
    file: Path,
    order: Order,
    drawn: Callable[[int, int], None] = lambda pictures, whole: None,
) -> Film:
    """Make a film of moments that are ``order.step`` apart; arguments and errors as of ``make``."""
    kind = files.kind(file)
    worlds.check(subject.world[0])
    story = frames.plan(RobotDescription.load(subject.robot), found, CAMERAS[order.camera], order.overlays)
    size = order.size or kind.size
    quality = STILL if order.fine else SMALL if size[0] <= _SMALL else MOVING
    stage = studio.Set(
        subject.robot, subject.world, size, quality,
        found.first if frames.MODES in order.overlays else None, order.speed,
    )  # fmt: skip
    whole = len(story.frames)
    rate = order.rate or kind.rate
    with closing(studio.draw(stage, story.frames)) as pictures:
        files.write(file, pictures, rate, lambda done: drawn(done, whole))
    return Film(file, whole, whole / rate, story.base, found.notices)
