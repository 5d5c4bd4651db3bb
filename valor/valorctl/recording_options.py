"""The recorder's options on the command line, as settings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from valor.common.errors import ConfigurationError
from valor.common.instance import Recording
from valor.common.table import TableError, checked

_AMOUNT = re.compile(r"(?P<number>\d+(\.\d+)?)\s*(?P<unit>[A-Za-z]+)")
_UNITS: dict[str, tuple[str, float]] = {  # [B] or [s]
    "kb": ("split_bytes", 1e3),
    "mb": ("split_bytes", 1e6),
    "gb": ("split_bytes", 1e9),
    "s": ("split_seconds", 1.0),
    "min": ("split_seconds", 60.0),
    "h": ("split_seconds", 3600.0),
}
_OPTIONS = {"split_bytes": "--bag-split", "split_seconds": "--bag-split", "ring_seconds": "--bag-ring"}


def recording(only: Sequence[str], without: Sequence[str], split: Sequence[str], ring: float | None) -> Recording:
    """Settings from ``--bag-only``, ``--bag-without``, ``--bag-split`` and ``--bag-ring``.

    Raises:
        ConfigurationError: names the option and what was expected.
    """
    if ring is not None and split:
        raise ConfigurationError("--bag-ring and --bag-split: expected one of them")
    values: dict[str, Any] = {"only": tuple(only), "without": tuple(without), "ring_seconds": ring}
    for text in split:
        match = _AMOUNT.fullmatch(text)
        if match is None or match["unit"].lower() not in _UNITS:
            raise ConfigurationError(f"--bag-split {text}: expected a size or a time, as 500MB, 2GB, 60s, 10min")
        key, factor = _UNITS[match["unit"].lower()]
        if key in values:
            raise ConfigurationError(f"--bag-split {text}: expected one size and one time at most")
        amount = float(match["number"]) * factor
        values[key] = round(amount) if key == "split_bytes" else amount
    try:
        return checked(Recording, values)
    except TableError as error:
        raise ConfigurationError(
            f"{_OPTIONS.get(error.key, error.key)}: {error.what}, got {values.get(error.key)}"
        ) from None
