"""What the robot was in, when: the bands under plots, and the timeline of modes."""

from __future__ import annotations

import html
from collections import deque
from collections.abc import Mapping

from valor.common.behaviors import ControlMode

COLORS: Mapping[str, str] = {
    ControlMode.NONE: "#9e9e9e",
    ControlMode.FREEZE: "#607d8b",
    ControlMode.STOP: "#607d8b",
    ControlMode.STAND_PREP: "#ffb74d",
    ControlMode.STAND: "#66bb6a",
    ControlMode.STAND_MANIPULATE: "#26a69a",
    ControlMode.MANIPULATE: "#29b6f6",
    ControlMode.STEP: "#5c6bc0",
    ControlMode.STEP_MANIPULATE: "#7e57c2",
    ControlMode.WALK: "#ab47bc",
    ControlMode.WALK_MANIPULATE: "#ec407a",
    ControlMode.SOFT_STOP: "#ef5350",
}
KEPT = 500


class Timeline:
    """Names, each with when it began [s]; times rise."""

    def __init__(self) -> None:
        self._began: deque[tuple[float, str]] = deque(maxlen=KEPT)

    def note(self, now: float, name: str) -> bool:
        """What it is now; whether that is news."""
        if self._began and self._began[-1][1] == name:
            return False
        self._began.append((now, name))
        return True

    def bands(self, begin: float, end: float) -> list[tuple[float, float, str]]:
        """From, to and name of what was between two times; nothing before the first note."""
        if not self._began:
            return []
        ends = [when for when, _ in list(self._began)[1:]] + [end]
        cut = [(max(when, begin), min(until, end), name) for (when, name), until in zip(self._began, ends, strict=True)]
        return [band for band in cut if band[1] > band[0]]

    def markup(self, begin: float, end: float, height: int = 18) -> str:
        """The bands as HTML, the names in them where there is room."""
        span = max(end - begin, 1e-9)
        parts = []
        for start, until, name in self.bands(begin, end):
            left, width = 100.0 * (start - begin) / span, 100.0 * (until - start) / span
            label = html.escape(name) if width > 12.0 else ""
            parts.append(
                f'<div title="{html.escape(name)}, {until - start:.0f} s" style="position:absolute;left:{left:.2f}%;'
                f"width:{width:.2f}%;height:100%;background:{COLORS.get(name, '#bdbdbd')};overflow:hidden;"
                f'color:#fff;font:11px/{height}px system-ui;text-align:center;white-space:nowrap">{label}</div>'
            )
        return f'<div style="position:relative;height:{height}px;margin:2px 0;background:#eee">{"".join(parts)}</div>'
