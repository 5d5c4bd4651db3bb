"""Orders over ssh, with a program in the place of ssh: what it prints and how it ends becomes an error or a result."""

import time
from pathlib import Path

import pytest

from valor.common.errors import ConfigurationError
from valor.common.instance import Host, Settings
from valor.valorctl.hosts.remote import GoneError, HostError, Order, Reply, command, execute, execute_all, require

MOTION = Host(name="motion", address="10.0.0.1", ssh="robot@motion")
SETTINGS = Settings(robot=Path("/"), ros_domain_id=0, hosts=(MOTION,), here="operator")
ORDER = Order("down", "default", {})
GREETING = '{"monotonic": 1000.0, "wall": 2000.0}'


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A shell script that is found as ``ssh``; the test writes it."""
    file = tmp_path / "ssh"
    file.touch(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    return file


def test_an_order_has_a_deadline_by_the_hosts_clock_and_returns_its_result(program: Path, tmp_path: Path) -> None:
    program.write_text(f"""#!/bin/sh
printf '%s\\n' "$*" > {tmp_path}/arguments
echo '{GREETING}'
read order
printf '%s' "$order" > {tmp_path}/order
echo '{{"result": true}}'
""")
    reply = execute(SETTINGS, MOTION, ORDER, 7.0)
    assert reply.result is True and abs(reply.ahead - (2000.0 - time.time())) < 60.0
    assert '"until":1007.0' in (tmp_path / "order").read_text()
    arguments = (tmp_path / "arguments").read_text()
    assert arguments.endswith("-T robot@motion valorctl host order\n") and "-o BatchMode=yes" in arguments


@pytest.mark.parametrize(
    ("script", "kind", "complaint"),
    [
        ("echo 'no route' >&2; exit 255", GoneError, r"host motion \(10\.0\.0\.1\) is unreachable: no route; check"),
        ("exit 255", GoneError, r"unreachable: ssh ended without a message; check `ssh robot@motion true`"),
        ("echo 'valorctl: not found' >&2; exit 127", HostError, r"exit status 127: valorctl: not found; expected"),
        ("echo Welcome", HostError, r"motion: its shell printed 'Welcome\\n'; expected a shell that prints nothing"),
        (f"echo '{GREETING}'; read order; exit 1", HostError, r"motion: .* ended with exit status 1: no message"),
        (f"echo '{GREETING}'; read order; exit 255", GoneError, r"unreachable"),
        (f"""echo '{GREETING}'; read order; echo '{{"error": "a\\nb"}}'""", HostError, r"^motion: a\nmotion: b$"),
    ],
)
def test_what_went_wrong_names_the_host(program: Path, script: str, kind: type[HostError], complaint: str) -> None:
    program.write_text(f"#!/bin/sh\n{script}\n".replace("\\n", "\\\\n"))
    with pytest.raises(kind, match=complaint):
        execute(SETTINGS, MOTION, ORDER, 7.0)


def test_of_several_hosts_each_failure_is_reported(program: Path) -> None:
    other = Host(name="other", address="10.0.0.2")
    settings = Settings(robot=Path("/"), ros_domain_id=0, hosts=(MOTION, other), here="operator")
    program.write_text(f"""#!/bin/sh
case "$*" in *motion*) echo 'Permission denied (publickey).' >&2; exit 255;; esac
echo '{GREETING}'
read order
echo '{{"result": 3}}'
""")
    answers = execute_all(settings, {"motion": ORDER, "other": ORDER}, 7.0)
    assert isinstance(answers["other"], Reply) and answers["other"].result == 3
    with pytest.raises(HostError, match=r"^host motion .*Permission denied[^\n]*$"):
        require(answers)


def test_a_missing_client_is_named_with_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(ConfigurationError, match=r"ssh: no such program; .*apt install openssh-client"):
        command(SETTINGS, MOTION)
