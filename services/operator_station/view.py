"""The robot's view, as its camera or the last window of the link's fast channel brought it, and how old it is."""

from __future__ import annotations

import io
import logging

import numpy as np
from PIL import Image, UnidentifiedImageError
from viser import GuiImageHandle, ViserServer

from valor.operator_station.heard import Heard

WIDEST = 640  # of what is sent on to viewers [px]
QUALITY = 75  # of the JPEG that they get
NONE = "No picture has come yet."
NONE_THROUGH_LINK = "No picture has come yet: one comes when the fast channel opens, if the robot has a camera."
_log = logging.getLogger("operator_station")


class View:
    """A part of the page, for all viewers."""

    def __init__(self, server: ViserServer, linked: bool) -> None:
        """``linked``: the robot is behind the link."""
        self._gui = server.gui
        self._said = NONE_THROUGH_LINK if linked else NONE
        self._text = self._gui.add_markdown(self._said)
        self._image: GuiImageHandle | None = None
        self._shown: bytes = b""

    def draw(self, heard: Heard, now: float) -> None:
        """What has changed; ``now``: monotonic [s]."""
        if heard.picture and heard.picture is not self._shown:
            self._shown = heard.picture
            self._show(heard.picture)
        if self._image is not None and (said := f"The picture is {heard.ages.text('picture', now)}.") != self._said:
            self._said = said
            self._text.content = said

    def _show(self, picture: bytes) -> None:
        try:
            with Image.open(io.BytesIO(picture)) as opened:
                opened.thumbnail((WIDEST, WIDEST))
                pixels = np.asarray(opened.convert("RGB"))
        except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError, SyntaxError) as error:
            _log.warning("the robot's picture is none: %s", error)
            return
        if self._image is None:
            self._image = self._gui.add_image(pixels, format="jpeg", jpeg_quality=QUALITY)
        else:
            self._image.image = pixels
