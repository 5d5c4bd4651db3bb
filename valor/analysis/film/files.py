"""Pictures in a row, as a file: MP4, GIF or WebP, by the name's ending."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

import av
import numpy as np

from valor.common import whole_file
from valor.common.errors import ConfigurationError, ValorError, expected
from valor.drawing.offscreen import Image


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        muxer, codec, pixels: libav's names.
        options: of the codec.
        muxing: options of the muxer.
        rate: pictures a second unless others are asked for.
        size: width and height unless others are asked for [pixels].
        palette: whether a picture has 256 colors, which are to be chosen.
    """

    muxer: str
    codec: str
    pixels: str
    options: Mapping[str, str]
    muxing: Mapping[str, str]
    rate: float
    size: tuple[int, int]
    palette: bool = False


_WEBP = {"quality": "72", "compression_level": "4"}
_LOOP = {"loop": "0"}
_H264 = {"preset": "veryfast", "crf": "21"}
# fmt: off
KINDS = {
    ".mp4":  Kind("mp4", "libx264", "yuv420p", _H264, {"movflags": "+faststart"}, 25.0, (1280, 720)),
    ".webp": Kind("webp", "libwebp_anim", "yuv420p", _WEBP, _LOOP, 12.5, (640, 360)),
    ".gif":  Kind("gif", "gif", "pal8", {}, _LOOP, 12.5, (480, 270), palette=True),
}
# fmt: on


def kind(file: Path) -> Kind:
    """By the ending.

    Raises:
        ConfigurationError: it is none of them; says which there are.
    """
    if file.suffix.lower() not in KINDS:
        raise ConfigurationError(f"{file}: suffix {expected(file.suffix, KINDS)}")
    return KINDS[file.suffix.lower()]


def write(file: Path, pictures: Iterator[Image], rate: float, told: Callable[[int], None]) -> None:
    """Write a film; the file is there as a whole or, if anything fails, not at all.

    Args:
        file: its ending says which kind.
        pictures: (height, width, 3) each, width and height even.
        rate: pictures a second.
        told: called with how many there are; may raise.

    Raises:
        ValorError: it cannot be written.
    """
    made_as = kind(file)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole_file.replacing(file) as beside:
            _encode(beside, made_as, pictures, Fraction(rate).limit_denominator(1001), told)
    except (OSError, av.FFmpegError) as error:
        text = getattr(error, "strerror", None) or str(error)
        raise ValorError(f"{file}: the film cannot be written: {text}") from None


def _encode(file: Path, made_as: Kind, pictures: Iterator[Image], rate: Fraction, told: Callable[[int], None]) -> None:
    first = next(pictures)
    height, width = first.shape[:2]
    with closing(av.open(str(file), "w", format=made_as.muxer, options=dict(made_as.muxing))) as container:
        stream: Any = container.add_stream(made_as.codec, rate=rate, options=dict(made_as.options))
        stream.width, stream.height, stream.pix_fmt = width, height, made_as.pixels
        stream.time_base = 1 / rate
        colors = _Palette(stream) if made_as.palette else None
        for number, picture in enumerate(chain([first], pictures)):
            frame: Any = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            frame.pts, frame.time_base = number, 1 / rate
            container.mux(stream.encode(colors.chosen(frame) if colors else frame))
            told(number + 1)
        container.mux(stream.encode(None))


class _Palette:
    """Pictures with the 256 colors that suit each best."""

    def __init__(self, stream: Any) -> None:
        graph: Any = av.filter.Graph()
        source = graph.add_buffer(width=stream.width, height=stream.height, format="rgb24", time_base=stream.time_base)
        split, choose = graph.add("split"), graph.add("palettegen", "stats_mode=single")
        use, sink = graph.add("paletteuse", "new=1:dither=bayer:bayer_scale=4"), graph.add("buffersink")
        source.link_to(split)
        split.link_to(use, 0, 0)
        split.link_to(choose, 1, 0)
        choose.link_to(use, 0, 1)
        use.link_to(sink)
        graph.configure()
        self._graph = graph

    def chosen(self, frame: Any) -> Any:
        self._graph.push(frame)
        return self._graph.pull()
