"""Film of a bag: read, plan, draw, write."""

from collections.abc import Callable, Collection
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from valor.analysis.film import frames, moments, studio
from valor.analysis.film.frames import CAMERAS
from valor.analysis.film.moments import Moments
from valor.bags.errors import BagError
from valor.bags.stored import origin_of, robot_of
from valor.common.errors import ConfigurationError, require_one_of
from valor.drawing.scene import MOVING, SMALL
from valor.robot.description import RobotDescription
from valor.simulation import worlds

OVERLAYS = (*frames.OVERLAYS, frames.MODES)
_SMALL = 800  # maximum width of a small picture [pixels]
SMALLEST, LARGEST = 64, 3840  # a side of the picture [pixels]


@dataclass(frozen=True)
class FilmOptions:
    """Options of a film. The constructor raises ``ConfigurationError`` if a value is invalid."""

    begin: float = 0.0  # since the start of the recording [s]
    end: float | None = None  # since then [s]; None: the end of the recording
    camera: str = "follow"  # one of ``CAMERAS``
    speed: float = 1.0  # recorded time per time of the film
    overlays: Collection[str] = ()  # some of ``OVERLAYS``
    size: tuple[int, int] | None = None  # width and height [pixels]; None: default of the file type
    rate: float | None = None  # [pictures/s]; None: default of the file type
    robot: Path | None = None  # its folder; None: that of the recording

    def __post_init__(self) -> None:
        require_one_of("camera", self.camera, CAMERAS)
        for overlay in self.overlays:
            require_one_of("overlay", overlay, OVERLAYS)
        if self.begin < 0.0:
            raise ConfigurationError(f"from {self.begin:g} s: expected at least 0 s after the start of the recording")
        if self.end is not None and self.end <= self.begin:
            raise ConfigurationError(f"from {self.begin:g} to {self.end:g} s: expected an end after the beginning")
        if not 0.01 <= self.speed <= 100.0:
            raise ConfigurationError(f"speed {self.speed:g}: expected 0.01 to 100 times the robot's")
        if self.rate is not None and not 1.0 <= self.rate <= 120.0:
            raise ConfigurationError(f"{self.rate:g} pictures a second: expected 1 to 120")
        if self.size and not all(SMALLEST <= side <= LARGEST and side % 2 == 0 for side in self.size):
            wrong = "×".join(map(str, self.size))
            raise ConfigurationError(f"size {wrong}: expected even sides of {SMALLEST} to {LARGEST} pixels")

    def step(self, file: Path) -> float:
        """Robot time between two pictures of a file [s]. Raises ``ConfigurationError``: the suffix is unknown."""
        return self.speed / (self.rate or studio.kind(file).rate)


@dataclass(frozen=True)
class Film:
    """Result: ``pictures`` in ``duration`` [s], source of the base pose, ``notices`` of the bag."""

    file: Path
    pictures: int
    duration: float
    base: str
    notices: list[str]


def make(
    bag: Path,
    file: Path,
    options: FilmOptions,
    read: Callable[[float], None] = lambda seconds: None,
    drawn: Callable[[int, int], None] = lambda pictures, total: None,
) -> Film:
    """Make a film of a recording; the suffix of ``file`` determines the type.

    ``read`` is called with the recorded time read [s], ``drawn`` with the numbers of pictures drawn and of all; both
    may raise; no file is left then.

    Raises:
        BagError: there is no bag, it lacks a topic, or it ends before the film begins.
        ConfigurationError: suffix, robot or world is unknown.
        RenderingError: off-screen OpenGL is not available.
        ValorError: the file cannot be written.
    """
    origin = origin_of(bag)
    world = origin.get("world", "flat"), int(origin.get("seed", "0"))
    robot = options.robot or robot_of(bag, origin)
    try:
        found = moments.read(bag, options.begin, options.end, options.step(file), read)
        return develop(found, robot, world, file, options, drawn=drawn)
    except BagError as error:
        text = str(error)
        raise BagError(text if text.startswith(str(bag)) else f"{bag}: {text}") from None


def develop(
    found: Moments,
    robot: Path,
    world: tuple[str, int],
    file: Path,
    options: FilmOptions,
    *,
    drawn: Callable[[int, int], None] = lambda pictures, total: None,
) -> Film:
    """Make a film of moments ``options.step`` apart, in a world by name and seed; the rest as in ``make``."""
    kind = studio.kind(file)
    require_one_of("world", world[0], worlds.WORLDS)
    story = frames.plan(RobotDescription.load(robot), found, CAMERAS[options.camera], options.overlays)
    size = options.size or kind.size
    quality = SMALL if size[0] <= _SMALL else MOVING
    origin = found.first if frames.MODES in options.overlays else None
    stage = studio.Stage(robot, world, size, quality, origin, options.speed)
    total = len(story.frames)
    rate = options.rate or kind.rate
    with closing(studio.draw(stage, story.frames)) as pictures:
        studio.write(file, pictures, rate, lambda done: drawn(done, total))
    return Film(file, total, total / rate, story.base, found.notices)
