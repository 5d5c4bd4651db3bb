"""How many examples a property test tries, and which: the same ones on every run, or those of ``make fuzz``."""

from __future__ import annotations

import os

import hypothesis
from hypothesis.database import DirectoryBasedExampleDatabase

from harness.places import REPOSITORY

FUZZ = int(os.environ.get("FUZZ", "0"))
"""Of ``make fuzz``: so many times the examples, other ones each time; 0: the same ones on every run."""
# How long an example takes is the machine's matter.
hypothesis.settings.register_profile(
    "valor",
    deadline=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
    derandomize=not FUZZ,
    database=DirectoryBasedExampleDatabase(REPOSITORY / ".hypothesis" / "examples") if FUZZ else None,
    print_blob=bool(FUZZ),
    max_examples=100 * max(1, FUZZ),
)
hypothesis.settings.load_profile("valor")


def examples(count: int, *allowed: hypothesis.HealthCheck) -> hypothesis.settings:
    """Settings of a property test: how many examples it tries, unless fuzzed, and what it may do besides."""
    checks = [*hypothesis.settings().suppress_health_check, *allowed]
    return hypothesis.settings(max_examples=count * max(1, FUZZ), suppress_health_check=checks)
