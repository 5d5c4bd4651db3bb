"""``--foxglove``: started on request; one line of error before the start if it cannot run."""

import socket
import subprocess
import sys

import pytest

from harness.instance import RunningInstance
from valor.common.errors import ConfigurationError
from valor.common.instance import FOXGLOVE_PORT, Listening
from valor.common.processes import EXIT_CONFIGURATION, FOXGLOVE
from valor.valorctl.instance import viewing
from valor.valorctl.instance.instance_setup import Request, plan

pytest.importorskip("foxglove", reason="the extra foxglove is not installed")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def test_foxglove_runs_only_on_request() -> None:
    unasked = plan(Request())
    assert FOXGLOVE not in unasked.profile.processes and unasked.settings.asked == ()
    assert viewing.foxglove_announcement(unasked.settings) is None
    port = free_port()
    asked = plan(Request(foxglove=str(port)))
    assert asked.profile.processes == (*unasked.profile.processes, FOXGLOVE)
    assert (asked.settings.asked, asked.settings.foxglove) == ((FOXGLOVE,), Listening(port=port))
    assert f"ws://127.0.0.1:{port}" in str(viewing.foxglove_announcement(asked.settings))


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("", "127.0.0.1", FOXGLOVE_PORT), ("0", "127.0.0.1", 0), ("0.0.0.0:9000", "0.0.0.0", 9000),
        ("[::1]:9000", "::1", 9000),
    ],
)  # fmt: skip
def test_an_address_is_a_port_with_an_optional_host(text: str, host: str, port: int) -> None:
    assert viewing.foxglove_address(text) == Listening(host=host, port=port)
    for malformed in ("eight", "70000", "-1", ":8765", "localhost:", "10.0.0.1"):
        with pytest.raises(ConfigurationError, match=r"--foxglove-at .*expected \[HOST:\]PORT"):
            viewing.foxglove_address(malformed)


def test_an_address_that_cannot_be_used_is_rejected_before_the_start() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ConfigurationError, match=rf"127.0.0.1:{port}: Address already in use; .*--foxglove-at"):
            plan(Request(foxglove=str(port)))
    with pytest.raises(ConfigurationError, match=r"192\.0\.2\.1:8765: .*expected an address of this computer"):
        plan(Request(foxglove="192.0.2.1:8765"))


def test_without_the_extra_the_error_names_the_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(ConfigurationError, match=r"not installed here: pip install 'valor\[foxglove\]'"):
        plan(Request(foxglove=""))


def test_the_process_ends_without_restart_if_it_cannot_run(instance: RunningInstance) -> None:
    start = "import sys; from valor.service import run; from valor.foxglove_bridge.service import FoxgloveBridge; "
    start += "sys.exit(run('foxglove_bridge', FoxgloveBridge))"
    with socket.create_server(("127.0.0.1", 0)) as other:
        instance.configure(foxglove={"host": "127.0.0.1", "port": other.getsockname()[1]})
        done = subprocess.run(
            [sys.executable, "-c", start],
            env=instance.environment, capture_output=True, text=True, timeout=60.0, check=False,
        )  # fmt: skip
    assert done.returncode == EXIT_CONFIGURATION, done.stderr
    assert "Address already in use" in done.stderr and "Traceback" not in done.stderr
