"""One instance for the tests of a file, reset after each; one browser."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from harness.instance import RunningInstance, fresh_instance
from harness.operator_page import chromium


@pytest.fixture(scope="module")
def module_instance() -> Iterator[RunningInstance]:
    """A ``fresh_instance`` for the tests of a file."""
    with (
        tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as home,
        fresh_instance(Path(home)) as running,
    ):
        yield running


@pytest.fixture
def instance(module_instance: RunningInstance) -> Iterator[RunningInstance]:
    """The file's instance, in which nothing but bifrostd runs."""
    settings = module_instance.settings
    yield module_instance
    module_instance.reset(settings)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser; the test is skipped where there is none."""
    with chromium() as browser:
        yield browser
