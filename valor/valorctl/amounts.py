"""Sizes and times as a person says them."""

from __future__ import annotations


def size_text(size: float) -> str:
    """``123.4 MB``; one decimal, in the unit that suits."""
    unit = "MB" if size < 1e9 else "GB"
    return f"{size / (1e6 if unit == 'MB' else 1e9):.1f} {unit}"


def time_text(seconds: float) -> str:
    """``12 s``, ``3.5 min``, ``2.0 h``, ``30.0 d``."""
    for limit, factor, unit in ((120.0, 1.0, "s"), (7200.0, 60.0, "min"), (172800.0, 3600.0, "h")):
        if seconds < limit:
            return f"{seconds / factor:.{0 if unit == 's' else 1}f} {unit}"
    return f"{seconds / 86400.0:.1f} d"
