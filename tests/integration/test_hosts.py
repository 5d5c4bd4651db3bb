"""An instance on three computers, without a robot: what every verb reports of all of them, and what it rejects."""

import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from harness.computers import ComputersError
from harness.hosts import Hosts, hosts, make_ssh_keys
from harness.system import VALORCTL
from harness.waiting import wait_until
from valor.common import pacing
from valor.common.instance import Instance
from valor.common.resources import robot_folder
from valor.valorctl.instance import supervisor_config
from valor.valorctl.instance.ros_domain import discovery_port
from valor.valorctl.instance.supervision import Supervisor, SupervisorError

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


READY = {"bifrostd": "ready", "footstep_converter": "ready"}


@pytest.fixture
def up(trio: Hosts) -> Iterator[Hosts]:
    """The instance is up on all hosts; restarted after a test that leaves it otherwise."""
    if not left(trio):
        trio.valorctl("operator", "up", "--deployment", str(trio.file))
    yield trio
    for name in trio.network.addresses:
        trio.network.plug(name)
    hosts_up = {Path(file).parents[1].name for file in left(trio)}
    if hosts_up and (hosts_up != set(trio.network.addresses) or trio.states("operator") != READY):
        trio.valorctl("operator", "down", "--deployment", str(trio.file))


@pytest.fixture
def down(trio: Hosts) -> Hosts:
    if left(trio):
        trio.valorctl("operator", "down", "--deployment", str(trio.file))
    return trio


def left(trio: Hosts) -> list[str]:
    """Files that exist only while an instance is up."""
    return [str(file) for name in trio.network.addresses for file in trio.home(name).glob("trio/*.json")]


def test_a_host_has_the_keys_of_its_own_processes_only(up: Hosts) -> None:
    owners = {name: {file.name for file in (up.home(name) / "trio/owners").iterdir()} for name in up.network.addresses}
    assert owners["perception"] == {"bifrostd", "footstep_converter"} and owners["motion"] == {"bifrostd"}
    modes = {file.stat().st_mode & 0o077 for name in up.network.addresses for file in up.home(name).glob("trio/**/*")}
    assert modes == {0}, "other users can read the instance's files"


def test_a_watched_status_reconnects_after_a_cut(up: Hosts) -> None:
    command = up.command("operator", str(VALORCTL), "status", "--watch", "--json")
    with subprocess.Popen(command, env=up.environment("operator"), stdout=subprocess.PIPE, text=True) as watch:
        assert watch.stdout is not None

        def problem() -> str:
            assert watch.stdout is not None
            return str(json.loads(watch.stdout.readline())["hosts"][1]["problem"])

        try:
            assert problem() == ""
            up.network.pull("perception")
            wait_until(lambda: "is unreachable" in problem(), 60.0, "the cut is reported")
            up.network.plug("perception")
            wait_until(lambda: problem() == "", 60.0, "ssh is connected again")
        finally:
            watch.kill()


def test_a_late_start_is_rejected_by_supervisord(up: Hosts) -> None:
    """As TCP delivers it after a cut: the deadline is by the clock of the host that receives it."""
    socket = up.home("perception") / "trio" / supervisor_config.SOCKET
    supervisor = Supervisor(Instance("trio", up.home("perception")), socket)
    supervisor._order("stop", "footstep_converter")
    clock = supervisor._call("clock", namespace=supervisor_config.NAMESPACE)
    with pytest.raises(SupervisorError, match=r"arrived \d\.\d s after its deadline; nothing was done"):
        supervisor._call("start", "footstep_converter", clock - 0.1, namespace=supervisor_config.NAMESPACE)
    wait_until(lambda: not supervisor.processes()["footstep_converter"].pid, 20.0, "it stays stopped")
    supervisor._call("start", "footstep_converter", clock + 20.0, namespace=supervisor_config.NAMESPACE)
    assert supervisor.processes()["footstep_converter"].pid


def test_a_late_order_is_rejected(up: Hosts) -> None:
    order = {"verb": "down", "instance": "trio", "until": -100.0, "arguments": {}}
    done = subprocess.run(
        up.command("perception", str(VALORCTL), "host", "order"), env=up.environment("perception"),
        input=json.dumps(order) + "\n", capture_output=True, text=True, check=True,
    )  # fmt: skip
    greeting, reply = map(json.loads, done.stdout.splitlines())
    assert abs(greeting["wall"] - time.time()) < 60.0
    assert re.fullmatch(r"down: arrived [\d.]+ s after its deadline; nothing was done", reply["error"])
    assert up.states("operator")["footstep_converter"] == "ready"


def test_processes_continue_without_ssh_and_are_found_again(up: Hosts) -> None:
    before = {row["name"]: row["pid"] for row in up.status("operator")["services"]}
    up.kill_ssh("perception")
    assert "is unreachable" in up.valorctl("operator", "status")
    up.start_ssh("perception")
    assert {row["name"]: row["pid"] for row in up.status("operator")["services"]} == before


def test_every_host_reports_all_processes_and_down_leaves_nothing(up: Hosts) -> None:
    for name in up.network.addresses:
        assert up.states(name) == READY
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
    assert up.states("motion") == READY, "the rejected `up` took it down"
    up.valorctl("perception", "down")
    assert left(up) == [] and not Path(f"/proc/{after}").exists()


def test_an_unreachable_host_is_named_and_taken_down_later(up: Hosts) -> None:
    gone = r"host perception \([\d.]+\) is unreachable: ssh: connect to host"
    up.network.pull("perception")
    seen = up.status("motion")
    assert [bool(host["problem"]) for host in seen["hosts"]] == [False, True, False]
    row = next(row for row in seen["services"] if row["name"] == "footstep_converter")
    assert row["state"] == "failed" and re.search(gone, row["detail"])
    assert re.search(gone, up.valorctl("operator", "doctor", expect=1))
    assert re.search(gone, up.valorctl("operator", "logs", "-n", "1"))
    assert re.search(gone, up.valorctl("operator", "down", expect=1))
    assert [Path(file).parents[1].name for file in left(up)] == ["perception"] * 2
    up.network.plug("perception")
    wait_until(
        lambda: (
            "perception: instance 'trio' is up already"
            in up.valorctl("operator", "up", "--deployment", str(up.file), expect=1)
        ),
        30.0,
        "perception is reachable, and `up` reports that it has not been taken down",
    )
    assert [Path(file).parents[1].name for file in left(up)] == ["perception"] * 2, "`up` left what it had started"


def test_a_killed_supervisord_is_named_and_cleared(up: Hosts) -> None:
    up.kill_supervisor("perception")
    problem = up.status("operator")["hosts"][1]["problem"]
    assert problem.startswith("perception: supervisord of instance 'trio' does not respond")
    up.valorctl("operator", "down")
    assert left(up) == [] and up.left("perception") == []


@contextmanager
def in_ros_domain(up: Hosts, name: str) -> Iterator[None]:
    """Another program in the instance's ROS domain on a computer."""
    domain = json.loads((up.home("motion") / "trio" / "instance.json").read_text())["ros_domain_id"]
    program = f"import socket; s = socket.socket(type=socket.SOCK_DGRAM); s.bind(('', {discovery_port(domain)}))"
    command = up.command(name, sys.executable, "-c", f"{program}; print('there', flush=True); input()")
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "there\n"
        yield
        process.kill()


def test_a_host_without_power_resumes_a_run_that_continues_and_none_that_is_over(up: Hosts) -> None:
    def ready() -> bool:
        return up.states("operator") == READY

    assert ready()
    up.cut_power("perception")
    assert up.states("operator")["footstep_converter"] == "failed"
    with in_ros_domain(up, "perception"):
        assert "started its part on perception again" in up.restore_power("perception")
        wait_until(ready, 60.0, "its part is started again", 0.5)
    up.cut_power("perception")
    assert "perception" in up.valorctl("operator", "down", expect=1)
    assert "its run is over" in up.restore_power("perception") and up.left("perception") == []
    looked = up.valorctl("operator", "doctor", "--deployment", str(up.file), expect=1)
    assert "trio has settings, but its supervisor does not respond" in looked


def test_nothing_resumes_while_no_other_host_is_reachable(up: Hosts) -> None:
    up.cut_power("perception")
    up.network.pull("perception")
    said = up.valorctl("perception", "host", "resume", expect=1)  # systemd calls it again
    assert "unreachable: motion, operator" in said and up.left("perception") == []
    up.network.plug("perception")
    up.restore_power("perception")
    wait_until(lambda: up.states("operator")["footstep_converter"] == "ready", 60.0, "its part is started again", 0.5)


def test_different_code_and_robots_are_rejected_by_name(down: Hosts, tmp_path: Path) -> None:
    changed = []
    for place in (robot_folder("escher") / "robot.yaml", Path(pacing.__file__)):
        (tmp_path / place.name).write_text(place.read_text() + "# another\n")
        changed.append((tmp_path / place.name, place))
    down.kill_ssh("perception")
    down.start_ssh("perception", instead=changed)
    try:
        said = down.valorctl("operator", "up", "--deployment", str(down.file), expect=1)
        differing = "perception: code, robot: expected the same version"
        assert f"{differing} as on operator" in said
        assert left(down) == [], "part of the instance was made"
        assert differing in down.valorctl("operator", "doctor", "--deployment", str(down.file), expect=1)
    finally:
        down.kill_ssh("perception")
        down.start_ssh("perception")


def test_a_full_disk_is_named_with_its_host_and_nothing_is_made(down: Hosts) -> None:
    try:
        with down.little_disk("perception", "24k") as folder:
            said = down.valorctl("operator", "up", "--deployment", str(down.file), expect=1)
            assert f"perception: {down.home('perception') / 'trio'}: No space left on device" in said
            assert left(down) == [] and not [file for file in folder.iterdir() if file.is_file()]
    except ComputersError as error:
        pytest.skip(str(error))
    down.valorctl("operator", "up", "--deployment", str(down.file))
    try:
        assert down.states("operator") == READY
    finally:
        down.valorctl("operator", "down", "--deployment", str(down.file))


def test_a_key_that_ssh_does_not_accept_changes_nothing(down: Hosts) -> None:
    stranger = down.folder / "stranger"
    make_ssh_keys(stranger)
    (stranger / "known_hosts").write_text(f"* {(down.folder / 'ssh/host_key.pub').read_text()}")
    file = down.folder / "stranger.yaml"
    file.write_text(down.file.read_text().replace("/ssh/ssh_config", "/stranger/ssh_config"))
    said = down.valorctl("operator", "up", "--deployment", str(file), expect=1)
    for name in ("motion", "perception"):
        assert re.search(rf"host {name} \([\d.]+\) is unreachable: .*Permission denied", said), said
    assert left(down) == []


def test_a_computer_that_is_no_host_is_rejected(down: Hosts) -> None:
    file = down.folder / "elsewhere.yaml"
    file.write_text(down.file.read_text().replace(down.network.addresses["operator"], "10.99.0.1"))
    said = down.valorctl("operator", "up", "--deployment", str(file), expect=1)
    assert "this computer has none of its addresses: " in said and "10.99.0.1 (operator)" in said
