"""What tests of the operator's page share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from harness.operator_page import chromium


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser; the test is skipped where there is none."""
    with chromium() as browser:
        yield browser
