"""The command line, in a home of the test's own."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.valorctl.command_line import Cli


@pytest.fixture
def ctl(home: Path) -> Iterator[Cli]:
    cli = Cli(home)
    try:
        yield cli
    finally:
        for process in cli.started:
            process.kill()
            process.communicate()
        for left in cli.processes():
            left.kill()
