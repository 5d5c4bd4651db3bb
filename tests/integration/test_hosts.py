"""An instance on three computers, without a robot: what every verb says of all of them, and what it refuses."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bifrost.network import copy_for
from harness.computers import ComputersError
from harness.hosts import Hosts, hosts
from harness.system import VALORCTL
from harness.waiting import wait_until
from valor.common import pacing
from valor.common.resources import robot_folder
from valor.valorctl.ros_domain import discovery_port

DEPLOYMENT = """\
description: ROS' side without a robot, on three computers
profile: ros.yaml
hosts:
  motion: {address: @motion}
  perception: {address: @perception, processes: [footstep_converter]}
  operator: {address: @operator}
"""
PROFILE = "description: ROS' side without a robot.\nprocesses: [bifrostd, footstep_converter]\n"


@pytest.fixture(scope="module")
def trio() -> Iterator[Hosts]:
    with tempfile.TemporaryDirectory(prefix="vh-", ignore_cleanup_errors=True) as folder:
        Path(folder, "ros.yaml").write_text(PROFILE)
        try:
            names = ("motion", "perception", "operator")
            with hosts(Path(folder), DEPLOYMENT, "trio", *names, perception=3.0, operator=-2.0) as made:
                yield made
        except ComputersError as error:
            pytest.skip(str(error))


@pytest.fixture
def up(trio: Hosts) -> Iterator[Hosts]:
    trio.valorctl("operator", "up", "--deployment", str(trio.file))
    yield trio
    for name in trio.network.addresses:
        trio.network.plug(name)
    trio.valorctl("operator", "down", "--deployment", str(trio.file))


def left(trio: Hosts) -> list[str]:
    """What is there only while an instance is up."""
    return [str(file) for name in trio.network.addresses for file in trio.home(name).glob("trio/*.json")]


def test_up_is_seen_from_everywhere_and_down_leaves_nothing(up: Hosts) -> None:
    for name in up.network.addresses:
        assert up.states(name) == {"bifrostd": "ready", "footstep_converter": "ready"}
    assert "spawned: 'footstep_converter'" in up.valorctl("motion", "logs", "supervisord", "-n", "50")
    said = re.search(
        r"stamps: motion is ([+-]\d+\.\d+) s ahead.*; perception is ([+-]\d+\.\d+) s ahead",
        up.valorctl("operator", "doctor"),
    )
    assert said and abs(float(said[1]) - 2.0) < 0.1 and abs(float(said[2]) - 5.0) < 0.1
    pid = re.compile(r"pid (\d+) → (\d+)")
    before, after = pid.findall(up.valorctl("operator", "restart", "footstep_converter"))[0]
    assert before != after and Path(f"/proc/{after}").exists()
    assert "is up already" in up.valorctl("motion", "up", "--deployment", str(up.file), expect=1)
    assert up.states("motion") == {"bifrostd": "ready", "footstep_converter": "ready"}, "who was refused took it down"
    up.valorctl("perception", "down")
    assert left(up) == [] and not Path(f"/proc/{after}").exists()


def test_each_host_has_no_key_that_is_anothers(up: Hosts) -> None:
    owners = {name: {file.name for file in (up.home(name) / "trio/owners").iterdir()} for name in up.network.addresses}
    assert owners["perception"] == {"bifrostd", "valorctl", "footstep_converter"}
    assert owners["motion"] == {"bifrostd", "valorctl"}
    agents = up.home("motion") / ".hosts/trio/owners"
    assert [file.name for file in agents.iterdir()] == ["motion"]


def test_a_host_that_is_gone_is_named_with_its_last_word(up: Hosts) -> None:
    gone = r"host perception \([\d.]+\) is gone; its last word, .*: trio: bifrostd, footstep_converter running"

    def named() -> bool:
        up.network.plug("perception")
        assert [host["problem"] for host in up.status("motion")["hosts"]] == ["", "", ""]
        up.network.pull("perception")
        row = next(row for row in up.status("motion")["services"] if row["name"] == "footstep_converter")
        assert row["state"] == "failed" and "host perception" in row["detail"]
        return all(re.search(gone, said) for said in (row["detail"], up.valorctl("operator", "doctor", expect=1)))

    wait_until(named, 90.0, "perception's last word is one from after it was up")
    assert re.search(gone, up.valorctl("operator", "down", expect=1))
    assert [Path(file).parents[1].name for file in left(up)] == ["perception"] * 2
    up.network.plug("perception")
    wait_until(
        lambda: (
            "perception: instance 'trio' is up already"
            in up.valorctl("operator", "up", "--deployment", str(up.file), expect=1)
        ),
        30.0,
        "perception is back, and says that it has not been taken down",
    )
    assert [Path(file).parents[1].name for file in left(up)] == ["perception"] * 2, "`up` left what it had begun"


def test_an_agent_that_is_begun_anew_finds_what_it_had_started(up: Hosts) -> None:
    up.stop_agent("perception")
    assert "is gone" in up.valorctl("operator", "status")
    up.start_agent("perception")
    assert up.states("operator") == {"bifrostd": "ready", "footstep_converter": "ready"}


@contextmanager
def in_ros_domain(up: Hosts, name: str) -> Iterator[None]:
    """Somebody's program in the instance's ROS domain on a computer."""
    domain = json.loads((up.home("motion") / "trio" / "instance.json").read_text())["ros_domain_id"]
    program = f"import socket; s = socket.socket(type=socket.SOCK_DGRAM); s.bind(('', {discovery_port(domain)}))"
    command = up.command(name, sys.executable, "-c", f"{program}; print('there', flush=True); input()")
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "there\n"
        yield
        process.kill()


def test_a_host_that_was_started_anew_takes_up_what_goes_on_and_nothing_that_is_over(up: Hosts) -> None:
    def ready() -> bool:
        return up.states("operator") == {"bifrostd": "ready", "footstep_converter": "ready"}

    assert ready()
    up.cut_power("perception")
    assert up.states("operator")["footstep_converter"] == "failed"
    with in_ros_domain(up, "perception"):
        up.start_agent("perception")
        wait_until(ready, 60.0, "its part is started again", 0.5)
    up.cut_power("perception")
    assert "perception" in up.valorctl("operator", "down", expect=1)
    up.start_agent("perception")
    said = up.folder / "perception.agent"
    looked = up.valorctl("operator", "doctor", "--deployment", str(up.file), expect=1)  # longer than asking the others
    assert "trio has settings, but its supervisor does not answer" in looked
    assert "started again" not in said.read_text()


def test_other_code_and_another_robot_are_refused_by_name(trio: Hosts, tmp_path: Path) -> None:
    changed = []
    for place in (robot_folder("escher") / "robot.yaml", Path(pacing.__file__)):
        (tmp_path / place.name).write_text(place.read_text() + "# another\n")
        changed.append((tmp_path / place.name, place))
    trio.stop_agent("perception")
    trio.start_agent("perception", instead=changed)
    try:
        said = trio.valorctl("operator", "up", "--deployment", str(trio.file), expect=1)
        differing = "code differs in valor/common/pacing.py; robot differs in robot.yaml"
        assert f"perception: {differing}; expected the same as on operator" in said
        assert left(trio) == [], "something was begun"
        assert differing in trio.valorctl("operator", "doctor", "--deployment", str(trio.file), expect=1)
    finally:
        trio.stop_agent("perception")
        trio.start_agent("perception")


def test_a_full_disk_is_named_with_its_host_and_nothing_is_begun(trio: Hosts) -> None:
    try:
        with trio.little_disk("perception", "24k") as folder:
            said = trio.valorctl("operator", "up", "--deployment", str(trio.file), expect=1)
            assert f"perception: {trio.home('perception') / 'trio'}: No space left on device" in said
            assert left(trio) == [] and not [file for file in folder.iterdir() if file.is_file()]
    except ComputersError as error:
        pytest.skip(str(error))
    trio.valorctl("operator", "up", "--deployment", str(trio.file))
    try:
        assert trio.states("operator") == {"bifrostd": "ready", "footstep_converter": "ready"}
    finally:
        trio.valorctl("operator", "down", "--deployment", str(trio.file))


def test_another_deployments_keys_get_no_word(trio: Hosts) -> None:
    (trio.folder / "stranger.yaml").write_text(trio.file.read_text())
    (trio.folder / "stranger").mkdir()

    def valorctl(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            trio.command("operator", str(VALORCTL), *arguments),
            env=trio.environment("operator") | {"VALOR_HOME": str(trio.folder / "stranger")},
            cwd=trio.folder,
            capture_output=True,
            text=True,
            check=False,
        )

    assert "has not joined deployment 'stranger'" in valorctl("up", "--deployment", "stranger.yaml").stderr
    assert valorctl("host", "join", "operator", "--deployment", "stranger.yaml").returncode == 0
    folder = trio.folder / "stranger/.hosts/stranger"
    (folder / "network.json").write_bytes(copy_for((folder / "made.json").read_bytes(), "operator"))
    unheard = valorctl("up", "--deployment", "stranger.yaml")
    assert unheard.returncode == 1
    for name in trio.network.addresses:
        assert f"{name} ({trio.network.addresses[name]}): no answer of its agent" in unheard.stderr
    assert left(trio) == []
