"""Words in a picture: what the robot does, when, and how fast the film runs."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from matplotlib import font_manager
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from valor.analysis import bands, style
from valor.drawing.offscreen import Image

_SHARE = 0.036  # of the picture's height
_SMALLEST = 11  # [pixels]


def write(image: Image, behavior: str, time: float, speed: float) -> Image:
    """A copy with the behavior on its band's color, the recording's time [s], and the speed if it is not 1."""
    picture = Pillow.fromarray(image)
    draw = ImageDraw.Draw(picture)
    size = max(_SMALLEST, round(_SHARE * picture.height))
    font, edge = _font(size), size // 2
    words = [(behavior.replace("_", " ") or "—", bands.color(behavior)), (f"{time:5.1f} s", "#ffffff")]
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
