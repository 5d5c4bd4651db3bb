"""An instance on three computers, the operator's behind the link: two networks, and its ends between them."""

from __future__ import annotations

import json
import socket
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from harness.computers import ComputersError
from harness.hosts import Hosts, hosts
from harness.waiting import wait_until
from valor.common.instance import Instance
from valor.valorctl import leftovers
from valor.valorctl.hosts.deployment import AGENT_PORT

DEPLOYMENT = """\
description: ROS' side without a robot, and the operator behind a link
profile: ros.yaml
hosts:
  motion: {address: @motion}
  perception: {address: @perception, processes: [footstep_converter, link_robot]}
  operator: {address: @operator, processes: [link_operator]}
link: {operators: [operator], lost_after: 3}
"""
PROFILE = "description: ROS' side without a robot.\nprocesses: [bifrostd, footstep_converter]\n"
ESTABLISHED = "01"  # in /proc/net/tcp
ALL = {"bifrostd", "footstep_converter", "link_robot", "link_operator"}


@pytest.fixture(scope="module")
def up() -> Iterator[Hosts]:
    with tempfile.TemporaryDirectory(prefix="vl-", ignore_cleanup_errors=True) as folder:
        Path(folder, "ros.yaml").write_text(PROFILE)
        try:
            with hosts(Path(folder), DEPLOYMENT, "trio", "motion", "perception", "operator") as made:
                made.valorctl("operator", "up", "--deployment", str(made.file))
                yield made
        except ComputersError as error:
            pytest.skip(str(error))


def healthy(up: Hosts, name: str) -> bool:
    """Whether every process is ready, as a computer sees it."""
    states = up.states(name)
    assert set(states) == ALL
    return set(states.values()) == {"ready"}


def connections(instance: Instance) -> set[str]:
    """Addresses that its computer is connected with by TCP, but for agents."""
    rows = Path(f"/proc/{leftovers.processes_of(instance)[0].pid}/net/tcp").read_text().splitlines()[1:]
    ends = [[end.split(":") for end in row.split()[1:3]] for row in rows if row.split()[3] == ESTABLISHED]
    others = [theirs for ours, theirs in ends if AGENT_PORT not in (int(ours[1], 16), int(theirs[1], 16))]
    found = {socket.inet_ntoa(bytes.fromhex(address)[::-1]) for address, _ in others}
    return {address for address in found if not address.startswith("127.")}


def test_one_command_brings_up_both_networks_and_every_host_sees_all(up: Hosts) -> None:
    for name in up.network.addresses:
        wait_until(partial(healthy, up, name), 60.0, f"all is ready as {name} sees it")
    rows = {row["name"]: row["processes"] for row in up.status("operator")["hosts"]}
    assert (rows["perception"], rows["operator"]) == (["footstep_converter", "link_robot"], ["link_operator"])
    said = up.valorctl("motion", "doctor")
    assert "perception: link_robot: the other end is heard" in said
    assert "operator: link_operator: the other end is heard" in said


def test_nothing_but_the_link_is_between_the_networks(up: Hosts) -> None:
    made = {name: Instance("trio", up.home(name)) for name in up.network.addresses}
    settings = {name: each.settings() for name, each in made.items()}
    domains = {name: each.ros_domain_id for name, each in settings.items()}
    assert domains["motion"] == domains["perception"] != domains["operator"] == settings["motion"].link.domain
    assert settings["operator"].peers == ()
    assert settings["motion"].peers == (up.network.addresses["perception"],)
    known = {
        name: [each["name"] for each in json.loads(instance.network_file.read_text())["computers"]]
        for name, instance in made.items()
    }
    robots = ["motion", "perception"]
    assert known == {"motion": robots, "perception": robots, "operator": ["operator"]}
    reached = {name: connections(made[name]) for name in made}
    addresses = up.network.addresses
    assert addresses["perception"] in reached["motion"], "none of Bifrost's own connections is seen"
    assert reached["operator"] <= {addresses["operator"]}, "somebody speaks past the link"


def test_a_cut_is_named_and_heals(up: Hosts) -> None:
    up.network.pull("operator")
    try:
        wait_until(lambda: up.states("perception")["link_robot"] == "degraded", 60.0, "the other end is missed")
        row = next(row for row in up.status("perception")["services"] if row["name"] == "link_robot")
        assert row["detail"] == "the other end of the link is not heard"
        assert up.states("perception")["footstep_converter"] == "ready"
    finally:
        up.network.plug("operator")
    wait_until(lambda: healthy(up, "perception"), 60.0, "the ends hear each other again")
    pids = {row["name"]: row["pid"] for row in up.status("motion")["services"]}
    up.valorctl("motion", "restart", "link_operator")
    wait_until(lambda: healthy(up, "operator"), 60.0, "a new end is heard")
    anew = {row["name"]: row["pid"] for row in up.status("operator")["services"]}
    assert {name for name in ALL if anew[name] != pids[name]} == {"bifrostd", "link_operator"}, "its own, and theirs"


def test_down_ends_both_networks(up: Hosts) -> None:
    up.valorctl("operator", "down")
    for name in up.network.addresses:
        assert not leftovers.processes_of(Instance("trio", up.home(name)))
