"""Parallel drawing of frames, one process per core, and the file of a film.

Process k of n draws every nth picture and sends it before it draws the next, so that at most n pictures are stored.
"""

import contextlib
import os
import signal
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import chain
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import av
import numpy as np
from matplotlib import font_manager
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from valor.analysis import bands, style
from valor.analysis.film.frames import Frame
from valor.common import whole_file
from valor.common.errors import ConfigurationError, ValorError, expected
from valor.drawing import RenderingError
from valor.drawing.offscreen import Image
from valor.drawing.scene import Quality, Scene
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import WHOLE_BODY

_SHARE = 0.036  # size of a caption, of the picture's height
_SMALLEST = 11  # [pixels]
_OTHER = "#ffd166"  # of a caption of another controller than the Whole-Body Controller
MOST = 8  # maximum number of processes; each stores the scene


@dataclass(frozen=True)
class Stage:
    """Common properties of all pictures."""

    robot: Path
    world: tuple[str, int]  # name and seed
    size: tuple[int, int]  # width and height [pixels]
    quality: Quality
    origin: float | None  # robot time at which the time in the captions is 0 [s]; None: no captions
    speed: float  # of the film, for the captions


def draw(stage: Stage, frames: list[Frame]) -> Generator[Image, None, None]:
    """The pictures, (height, width, 3) each, in order.

    Raises RenderingError (no off-screen OpenGL) or ValorError (robot or world cannot be loaded).
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
        raise RenderingError("a drawing process ended; expected a picture") from None
    if isinstance(found, ValorError):
        raise found
    image: Image = found
    return image


@contextlib.contextmanager
def _environment() -> Iterator[None]:
    """Environment in which processes use one core each for OpenGL on the CPU."""
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


def _work(end: Connection, stage: Stage, frames: list[Frame]) -> None:
    for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(signum, signal.SIG_IGN)  # from the terminal: the parent handles them
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):
        try:
            for image in _draw(stage, frames):
                end.send(image)
        except ValorError as error:
            end.send(type(error)(str(error)))


def _draw(stage: Stage, frames: list[Frame]) -> Iterator[Image]:
    robot = RobotDescription.load(stage.robot)
    with closing(Scene(robot, *stage.size, *stage.world, quality=stage.quality)) as scene:
        for frame in frames:
            view = frame.view
            scene.look_at(view.point, view.azimuth, view.elevation, view.distance)
            image = scene.draw(frame.posture, frame.marks)
            if stage.origin is not None:
                time = frame.posture.time - stage.origin
                image = _caption(image, frame.posture.behavior, frame.controller, time, stage.speed)
            yield image


def _caption(image: Image, behavior: str, controller: str, time: float, speed: float) -> Image:
    """Copy an image and add behavior, controller, recorded time [s], and the speed unless it is 1."""
    picture = Pillow.fromarray(image)
    draw = ImageDraw.Draw(picture)
    size = max(_SMALLEST, round(_SHARE * picture.height))
    font, edge = _font(size), size // 2
    words = [(behavior.replace("_", " ") or "—", bands.color(behavior)), (f"{time:5.1f} s", "#ffffff")]
    if controller:
        words.insert(1, (controller.replace("_", " "), "#ffffff" if controller == WHOLE_BODY else _OTHER))
    if speed != 1.0:
        words.append((f"×{speed:g}", "#ffffff"))
    left, top = 2.0 * edge, picture.height - 2 * edge - 2 * size
    for text, color in words:
        width = draw.textlength(text, font=font)
        box = (left, top, left + width + 2 * edge, top + 2 * size - edge // 2)
        draw.rounded_rectangle(box, radius=edge, fill=color)
        draw.text((left + edge, (box[1] + box[3]) / 2), text, font=font, fill=style.INK, anchor="lm")
        left += width + 3 * edge
    return np.asarray(picture)


@lru_cache(maxsize=4)
def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(font_manager.findfont(style.FONT), size)


@dataclass(frozen=True)
class Kind:
    """A type of file."""

    muxer: str  # libav's name
    codec: str  # libav's name
    options: Mapping[str, str]  # of the codec
    muxing: Mapping[str, str]  # options of the muxer
    rate: float  # default rate [pictures/s]
    size: tuple[int, int]  # default width and height [pixels]


_WEBP = {"quality": "72", "compression_level": "4"}
_H264 = {"preset": "veryfast", "crf": "21"}
KINDS = {
    ".mp4": Kind("mp4", "libx264", _H264, {"movflags": "+faststart"}, 25.0, (1280, 720)),
    ".webp": Kind("webp", "libwebp_anim", _WEBP, {"loop": "0"}, 12.5, (640, 360)),
}


def kind(file: Path) -> Kind:
    """Type of a file, by suffix. Raises ``ConfigurationError``: the suffix is unknown; lists the known ones."""
    if file.suffix.lower() not in KINDS:
        raise ConfigurationError(f"{file}: suffix {expected(file.suffix, KINDS)}")
    return KINDS[file.suffix.lower()]


def write(file: Path, pictures: Iterator[Image], rate: float, drawn: Callable[[int], None]) -> None:
    """Write a film of pictures, (height, width, 3) each, at a rate [pictures/s]; ``drawn`` receives their number.

    The file is complete, or absent if anything fails. Raises ValorError: it cannot be written.
    """
    made_as = kind(file)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole_file.replacing(file) as beside:
            _encode(beside, made_as, pictures, Fraction(rate).limit_denominator(1001), drawn)
    except (OSError, av.FFmpegError) as error:
        text = getattr(error, "strerror", None) or str(error)
        raise ValorError(f"{file}: the film cannot be written: {text}") from None


def _encode(file: Path, made_as: Kind, pictures: Iterator[Image], rate: Fraction, drawn: Callable[[int], None]) -> None:
    first = next(pictures)
    height, width = first.shape[:2]
    with closing(av.open(str(file), "w", format=made_as.muxer, options=dict(made_as.muxing))) as container:
        stream: Any = container.add_stream(made_as.codec, rate=rate, options=dict(made_as.options))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = 1 / rate
        for number, picture in enumerate(chain([first], pictures)):
            frame: Any = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            frame.pts, frame.time_base = number, 1 / rate
            container.mux(stream.encode(frame))
            drawn(number + 1)
        container.mux(stream.encode(None))
