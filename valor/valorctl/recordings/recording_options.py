"""Conversion of the recorder's options to settings: topics, pieces, and bounds of all recordings."""

import re
from collections.abc import Sequence
from typing import Any

from valor.common.errors import ConfigurationError
from valor.common.instance import DAY, UNBOUNDED, Bounds, Recording
from valor.common.table import TableError, checked, plain

BOUND = "--bag-bound"
BOUND_VARIABLE = "VALOR_BAG_BOUND"
NO_BOUND = "none"

_AMOUNT = re.compile(r"(?P<number>\d+(\.\d+)?)\s*(?P<unit>[A-Za-z]+|%)")
_UNITS: dict[str, tuple[str, float]] = {  # [B], [s] or a part of the disk
    "kb": ("size", 1e3),
    "mb": ("size", 1e6),
    "gb": ("size", 1e9),
    "tb": ("size", 1e12),
    "s": ("time", 1.0),
    "min": ("time", 60.0),
    "h": ("time", 3600.0),
    "d": ("time", DAY),
    "%": ("share", 0.01),
}
_SPLIT = {"size": "split_bytes", "time": "split_seconds"}
_BOUND = {"size": "size", "time": "age", "share": "share"}
_OPTIONS = {"split_bytes": "--bag-split", "split_seconds": "--bag-split", "ring_seconds": "--bag-ring"}


def recording(
    only: Sequence[str] = (), without: Sequence[str] = (), split: Sequence[str] = (), ring: float | None = None
) -> Recording:
    """Settings from the options ``--bag-…``; raises ``ConfigurationError`` with option, value and expectation."""
    if ring is not None and split:
        raise ConfigurationError("--bag-ring and --bag-split: expected one of them")
    values: dict[str, Any] = {"only": tuple(only), "without": tuple(without), "ring_seconds": ring}
    pieces = _amounts("--bag-split", split, _SPLIT, "a size or a time, as 500MB, 2GB, 60s, 10min")
    values |= {key: round(amount) if key == "split_bytes" else amount for key, amount in pieces.items()}
    try:
        return checked(Recording, values)
    except TableError as error:
        raise ConfigurationError(f"{_OPTIONS.get(error.key, error.key)}: {error.what}") from None


def bounds(words: Sequence[str], base: Bounds, where: str = BOUND) -> Bounds:
    """Parse bounds: ``20GB``, ``30d``, ``10%``, at most one of each kind; or ``none``.

    ``base``: bounds of the other kinds; ``where``: option or key, for the ``ConfigurationError``.
    """
    expected = "a size, an age or a part of the disk, as 20GB, 30d, 10%, or none"
    if NO_BOUND in words:
        if len(words) > 1:
            raise ConfigurationError(f"{where} {' '.join(words)}: expected {NO_BOUND} by itself, or bounds")
        return UNBOUNDED
    values = _amounts(where, words, _BOUND, expected)
    values |= {"size": round(values["size"])} if "size" in values else {}
    try:
        return checked(Bounds, plain(base) | values)
    except TableError as error:
        raise ConfigurationError(f"{' '.join((where, *words))}: {error.what}") from None


def _amounts(where: str, words: Sequence[str], keys: dict[str, str], expected: str) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for word in words:
        match = _AMOUNT.fullmatch(word)
        kind, factor = _UNITS.get(match["unit"].lower(), ("", 0.0)) if match else ("", 0.0)
        if match is None or kind not in keys:
            raise ConfigurationError(f"{where} {word}: expected {expected}")
        if keys[kind] in values:
            raise ConfigurationError(f"{where} {word}: expected one of each kind at most: {expected}")
        values[keys[kind]] = float(match["number"]) * factor
    return values
