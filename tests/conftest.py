"""Fixtures: an instance of one's own, with real processes and real sockets, that leaves nothing behind."""

import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from harness import examples  # noqa: F401 the profile of all property tests
from harness.instance import RunningInstance, fresh_instance
from valor.valorctl.instance.ros_domain import reserve

UNTIL = float(os.environ.get("VALOR_TESTS_UNTIL", "inf"))  # tests that have not started are skipped then [s, epoch]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Skip what there is no time for."""
    if time.time() > UNTIL:
        pytest.skip("no time left in this run: make test-clients")


Valorctl = Callable[..., tuple[int, str, str]]

# A shell starts what runs in its background with SIGINT ignored, and that is inherited: the processes that tests
# interrupt would go on for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def home() -> Iterator[Path]:
    """A short-named VALOR_HOME of the test's own (socket names are limited to 108 bytes)."""
    folder = Path(tempfile.mkdtemp(prefix="valor-"))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="session")
def ros_domain() -> Iterator[int]:
    """A ROS domain, and the ports that go with it, that nobody else on this computer has."""
    with reserve(f"tests {os.getpid()}") as reservation:
        yield reservation.domain


@pytest.fixture
def instance(home: Path) -> Iterator[RunningInstance]:
    with fresh_instance(home) as running:
        yield running


@pytest.fixture
def valorctl(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Valorctl:
    """Run a command line in this process; returns exit status, output and errors."""
    from valor.valorctl.__main__ import run

    def called(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["valorctl", *arguments])
        try:
            status = run()
        except SystemExit as ended:
            status = int(ended.code or 0)
        return status, *capsys.readouterr()

    return called
