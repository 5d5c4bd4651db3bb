"""``--foxglove``: asked for, it is there; where it cannot be, one line says why before anything starts."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest

from harness.instance import RunningInstance
from valor.common.errors import ConfigurationError
from valor.common.instance import FOXGLOVE_PORT, Listening
from valor.common.processes import EXIT_CONFIGURATION, FOXGLOVE
from valor.valorctl import foxglove_options
from valor.valorctl.instance_setup import Request, plan

pytest.importorskip("foxglove", reason="the extra foxglove is not installed")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def test_it_runs_where_it_is_asked_for_alone() -> None:
    unasked = plan(Request())
    assert FOXGLOVE not in unasked.profile.processes and unasked.settings.asked == ()
    assert foxglove_options.announcement(unasked.settings) is None
    port = free_port()
    asked = plan(Request(foxglove=str(port)))
    assert asked.profile.processes == (*unasked.profile.processes, FOXGLOVE)
    assert (asked.settings.asked, asked.settings.foxglove) == ((FOXGLOVE,), Listening(port=port))
    assert f"ws://127.0.0.1:{port}" in str(foxglove_options.announcement(asked.settings))


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("", "127.0.0.1", FOXGLOVE_PORT),
        ("8766", "127.0.0.1", 8766),
        ("0", "127.0.0.1", 0),
        ("0.0.0.0:9000", "0.0.0.0", 9000),
        ("[::1]:9000", "::1", 9000),
    ],
)
def test_an_address_is_a_port_of_this_computer_or_says_whose(text: str, host: str, port: int) -> None:
    assert foxglove_options.listening(text) == Listening(host=host, port=port)


@pytest.mark.parametrize("text", ["eight", "70000", "-1", ":8765", "localhost:", "10.0.0.1"])
def test_anything_else_is_refused_by_name(text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"--foxglove-at .*expected \[HOST:\]PORT"):
        foxglove_options.listening(text)


def test_a_port_that_another_program_has_is_said_before_anything_starts() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ConfigurationError, match=rf"127.0.0.1:{port}: Address already in use; .*--foxglove-at"):
            plan(Request(foxglove=str(port)))


def test_an_address_that_is_none_of_this_computer_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"192\.0\.2\.1:8765: .*expected an address of this computer"):
        plan(Request(foxglove="192.0.2.1:8765"))


def test_without_the_extra_it_is_said_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(ConfigurationError, match=r"not installed here: pip install 'valor\[foxglove\]'"):
        plan(Request(foxglove=""))


def test_the_process_itself_ends_for_good_where_it_cannot_run(instance: RunningInstance) -> None:
    start = "import sys; {}; from valor.service import run; from valor.foxglove_bridge.service import FoxgloveBridge; "
    start += "sys.exit(run('foxglove_bridge', FoxgloveBridge))"
    with socket.create_server(("127.0.0.1", 0)) as other:
        instance.configure(foxglove={"host": "127.0.0.1", "port": other.getsockname()[1]})
        for before, line in (
            ("sys.modules['foxglove'] = None", "foxglove is not installed here: pip install 'valor[foxglove]'"),
            ("pass", "Address already in use"),
        ):
            done = subprocess.run(
                [sys.executable, "-c", start.format(before)],
                env=instance.environment, capture_output=True, text=True, timeout=60.0, check=False,
            )  # fmt: skip
            assert done.returncode == EXIT_CONFIGURATION, done.stderr
            assert line in done.stderr and "Traceback" not in done.stderr
