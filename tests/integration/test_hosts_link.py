"""An instance on three computers, the operator's behind the link: nothing joins the two networks but its UDP ports."""

import json
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from harness.computers import ComputersError
from harness.hosts import SSH_PORT, Hosts, hosts
from harness.places import REPOSITORY
from harness.waiting import wait_until
from valor.common.instance import Instance
from valor.valorctl.hosts.deployment import LINK_PORT
from valor.valorctl.instance import shutdown

DEPLOYMENT = """\
description: ROS' side without a robot, and the operator behind a link
profile: ros.yaml
hosts:
  motion: {address: @motion}
  perception: {address: @perception, processes: [footstep_converter, link_robot]}
  operator: {address: @operator, processes: [link_operator]}
link: {operators: [operator], operator_timeout: 3, relay: "@between:9000"}
"""
PROFILE = "description: ROS' side without a robot.\nprocesses: [bifrostd, footstep_converter]\n"
ESTABLISHED = "01"  # in /proc/net/tcp
ROBOT = {"bifrostd", "footstep_converter", "link_robot"}
OPERATOR = {"bifrostd", "link_operator"}


@contextmanager
def between(made: Hosts) -> Iterator[None]:
    """The relay of the link, with the bandwidth of the finals."""
    to = f"{made.network.addresses['perception']}:{LINK_PORT}"
    listen = f"{made.network.between[1]}:9000"
    program = [sys.executable, "-m", "harness.link_emulator", "--listen", listen, "--to", to]
    with subprocess.Popen(
        [*made.network.inside_between(), *program], stdout=subprocess.DEVNULL, cwd=REPOSITORY
    ) as emulator:
        try:
            yield
        finally:
            emulator.kill()


@pytest.fixture(scope="module")
def apart() -> Iterator[Hosts]:
    with tempfile.TemporaryDirectory(prefix="vl-", ignore_cleanup_errors=True) as folder:
        Path(folder, "ros.yaml").write_text(PROFILE)
        try:
            with (
                hosts(Path(folder), DEPLOYMENT, "trio", "motion", "perception", "operator", apart=["operator"]) as made,
                between(made),
            ):
                yield made
        except ComputersError as error:
            pytest.skip(str(error))


@pytest.fixture(scope="module")
def up(apart: Hosts) -> Hosts:
    said = apart.valorctl("operator", "up", "--deployment", str(apart.file))
    assert "robot's side: on motion or perception, by ssh" in said
    assert "link_operator degraded: no datagrams of the other end of the link" in said
    seen = apart.status("operator")
    assert not seen["ready"] and [(host["name"], host["problem"]) for host in seen["hosts"]] == [("operator", "")]
    apart.valorctl("motion", "up", "--deployment", str(apart.file))
    return apart


def healthy(up: Hosts, name: str) -> bool:
    """Return whether every process is ready, as a computer reports it."""
    states = up.states(name)
    assert set(states) == (OPERATOR if name == "operator" else ROBOT)
    return set(states.values()) == {"ready"}


def connections(instance: Instance) -> set[str]:
    """Addresses to which its computer has TCP connections, ssh excepted."""
    rows = Path(f"/proc/{shutdown.processes_of(instance)[0].pid}/net/tcp").read_text().splitlines()[1:]
    ends = [[end.split(":") for end in row.split()[1:3]] for row in rows if row.split()[3] == ESTABLISHED]
    others = [theirs for ours, theirs in ends if SSH_PORT not in (int(ours[1], 16), int(theirs[1], 16))]
    found = {socket.inet_ntoa(bytes.fromhex(address)[::-1]) for address, _ in others}
    return {address for address in found if not address.startswith("127.")}


def test_verbs_for_the_robots_side_name_the_host_to_run_them_on(up: Hosts) -> None:
    for name in up.network.addresses:
        wait_until(partial(healthy, up, name), 60.0, f"{name} reports that all is ready")
    for verb in ("restart", "logs"):
        said = up.valorctl("operator", verb, "link_robot", expect=1)
        assert f"`ssh perception valorctl {verb} link_robot`" in said
    for command in (("walk", "--vx", "0.1"), ("mode", "walk"), ("arm", "right", "forward"), ("bag", "snap")):
        said = up.valorctl("operator", *command, expect=1)
        assert "run the verb on motion or perception" in said, said
    assert "robot's side: on motion or perception, by ssh" in up.valorctl("operator", "status")


def test_nothing_but_the_link_is_between_the_networks(up: Hosts) -> None:
    made = {name: Instance("trio", up.home(name)) for name in up.network.addresses}
    settings = {name: each.settings() for name, each in made.items()}
    domains = {name: each.ros_domain_id for name, each in settings.items()}
    assert domains["motion"] == domains["perception"] != domains["operator"] == settings["operator"].link.domain
    assert settings["operator"].peers == () and settings["motion"].peers == (up.network.addresses["perception"],)
    known = {
        name: [each["name"] for each in json.loads(instance.network_file.read_text())["computers"]]
        for name, instance in made.items()
    }
    robots = ["motion", "perception"]
    assert known == {"motion": robots, "perception": robots, "operator": ["operator"]}
    reached = {name: connections(made[name]) for name in made}
    addresses = up.network.addresses
    assert addresses["perception"] in reached["motion"], "no connection of Bifrost is found"
    assert reached["operator"] <= {addresses["operator"]}, "a connection bypasses the link"


def test_a_cut_is_named_and_heals(up: Hosts) -> None:
    up.network.pull("operator")
    try:
        wait_until(lambda: up.states("perception")["link_robot"] == "degraded", 60.0, "the other end is missing")
        row = next(row for row in up.status("perception")["services"] if row["name"] == "link_robot")
        assert row["detail"] == "no datagrams of the other end of the link"
        assert up.states("perception")["footstep_converter"] == "ready"
    finally:
        up.network.plug("operator")
    wait_until(lambda: healthy(up, "perception"), 60.0, "the ends receive again")
    wait_until(lambda: healthy(up, "operator"), 60.0, "both ends receive")


def test_down_ends_this_side_and_names_the_other(up: Hosts) -> None:
    said = up.valorctl("operator", "down")
    assert "instance 'trio' is down on operator" in said and "processes on the robot's side keep running" in said
    wait_until(lambda: not up.left("operator"), 30.0, "nothing is left on the operator's side")
    assert set(up.states("motion")) == ROBOT
    up.valorctl("motion", "down")
    wait_until(lambda: not any(map(up.left, up.network.addresses)), 30.0, "nothing is left on any")
    assert "was not up" in up.valorctl("operator", "down", "--deployment", str(up.file))
