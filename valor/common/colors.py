"""What has which color wherever a robot is drawn with what it feels: films, the operator's page, Foxglove.

Okabe and Ito's, which people tell apart who do not see all colors.
"""

from __future__ import annotations

LEFT, RIGHT = "#0072b2", "#d55e00"  # feet, soles, knees
FORCE, SUPPORT, COM, DCM, DCM_REFERENCE, COP = "#d55e00", "#56b4e9", "#e69f00", "#cc79a7", "#22272e", "#009e73"
BALANCE = {"com": COM, "dcm": DCM, "dcm_reference": DCM_REFERENCE, "cop": COP}
"""By the name of the point's topic."""


def rgb(color: str) -> tuple[int, int, int]:
    """Red, green and blue of ``#rrggbb``, 0 to 255."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue
