"""An instance on three computers, the operator's behind the link: nothing joins the two networks but its UDP ports."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from harness.computers import ComputersError
from harness.hosts import Hosts, hosts
from harness.waiting import wait_until
from valor.common.instance import Instance
from valor.valorctl import leftovers
from valor.valorctl.hosts.apart import LINK_PORT
from valor.valorctl.hosts.deployment import AGENT_PORT

DEPLOYMENT = """\
description: ROS' side without a robot, and the operator behind a link
profile: ros.yaml
hosts:
  motion: {address: @motion}
  perception: {address: @perception, processes: [footstep_converter, link_robot]}
  operator: {address: @operator, processes: [link_operator]}
link: {operators: [operator], lost_after: 3, through: "@between:9000"}
"""
PROFILE = "description: ROS' side without a robot.\nprocesses: [bifrostd, footstep_converter]\n"
ESTABLISHED = "01"  # in /proc/net/tcp
ROBOT = {"bifrostd", "footstep_converter", "link_robot"}
ALL = {*ROBOT, "link_operator"}


@contextmanager
def between(made: Hosts) -> Iterator[None]:
    """What the link goes through, as narrow as in the finals."""
    to = f"{made.network.addresses['perception']}:{LINK_PORT}"
    listen = f"{made.network.between[1]}:9000"
    program = [sys.executable, "-m", "valor.link.emulate", "--listen", listen, "--to", to]
    with subprocess.Popen([*made.network.inside_between(), *program], stdout=subprocess.DEVNULL) as emulator:
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
    assert "on motion or perception, `valorctl status`, `valorctl up --deployment FILE`" in said, "where, and what"
    assert "link_operator degraded: the other end of the link is not heard" in said
    seen = apart.status("operator")
    assert (seen["beyond_age_s"], seen["ready"]) == (None, False)
    assert [bool(host["problem"]) for host in seen["hosts"]] == [True, True, False]
    apart.valorctl("motion", "up", "--deployment", str(apart.file))
    return apart


def healthy(up: Hosts, name: str) -> bool:
    """Whether every process is ready, as a computer sees it."""
    states = up.states(name)
    assert set(states) == (ALL if name == "operator" else ROBOT)
    return set(states.values()) == {"ready"}


def connections(instance: Instance) -> set[str]:
    """Addresses that its computer is connected with by TCP, but for agents."""
    rows = Path(f"/proc/{leftovers.processes_of(instance)[0].pid}/net/tcp").read_text().splitlines()[1:]
    ends = [[end.split(":") for end in row.split()[1:3]] for row in rows if row.split()[3] == ESTABLISHED]
    others = [theirs for ours, theirs in ends if AGENT_PORT not in (int(ours[1], 16), int(theirs[1], 16))]
    found = {socket.inet_ntoa(bytes.fromhex(address)[::-1]) for address, _ in others}
    return {address for address in found if not address.startswith("127.")}


def test_the_operators_side_sees_the_robots_through_the_link_with_its_age(up: Hosts) -> None:
    for name in up.network.addresses:
        wait_until(partial(healthy, up, name), 60.0, f"all is ready as {name} sees it")
    began = time.monotonic()
    seen = up.status("operator")
    assert 0.0 < seen["beyond_age_s"] < time.monotonic() - began
    there = {row["name"]: row["pid"] for row in up.status("motion")["services"]}
    here = {row["name"]: row["pid"] for row in seen["services"]}
    assert {name: here[name] for name in ROBOT - {"bifrostd"}} == {name: there[name] for name in ROBOT - {"bifrostd"}}
    rows = {row["name"]: (row["processes"], row["problem"]) for row in seen["hosts"]}
    assert rows["perception"] == (["footstep_converter", "link_robot"], "")
    assert "robot's side: through the link, at most" in up.valorctl("operator", "status")


def test_its_processes_are_started_anew_and_their_logs_read_through_the_link(up: Hosts) -> None:
    pids = {row["name"]: row["pid"] for row in up.status("motion")["services"]}
    told = up.valorctl("operator", "restart", "footstep_converter")
    said = re.search(r"footstep_converter restarted: pid (\d+) → (\d+)", told)
    assert said and int(said[1]) == pids["footstep_converter"]
    anew = {row["name"]: row["pid"] for row in up.status("motion")["services"]}
    assert anew == pids | {"footstep_converter": int(said[2])}
    log = up.valorctl("operator", "logs", "footstep_converter", "-n", "3")
    assert log.splitlines() == up.valorctl("perception", "logs", "footstep_converter", "-n", "3").splitlines()
    assert "motion or perception can" in up.valorctl("operator", "logs", "footstep_converter", "-f", expect=1)
    up.valorctl("operator", "restart", "link_robot")

    def anew_and_ready() -> bool:
        rows = {row["name"]: row for row in up.status("operator")["services"]}
        seen = rows["link_robot"]
        return bool(seen["state"] == "ready" and seen["pid"] != pids["link_robot"])

    wait_until(anew_and_ready, 60.0, "the link has begun anew")


def test_nothing_but_the_link_is_between_the_networks(up: Hosts) -> None:
    made = {name: Instance("trio", up.home(name)) for name in up.network.addresses}
    settings = {name: each.settings() for name, each in made.items()}
    domains = {name: each.ros_domain_id for name, each in settings.items()}
    assert domains["motion"] == domains["perception"] != domains["operator"] == settings["operator"].link.domain
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
    agents = {name: up.home(name) / ".hosts/trio/network.json" for name in up.network.addresses}
    rows = {name: json.loads(file.read_text())["computers"] for name, file in agents.items()}
    dialed = {name: [each["name"] for each in computers] for name, computers in rows.items()}
    assert dialed == known, "an agent knows hosts beyond the link"


def test_a_cut_is_named_and_heals(up: Hosts) -> None:
    up.network.pull("operator")
    try:
        wait_until(lambda: up.states("perception")["link_robot"] == "degraded", 60.0, "the other end is missed")
        row = next(row for row in up.status("perception")["services"] if row["name"] == "link_robot")
        assert row["detail"] == "the other end of the link is not heard"
        assert up.states("perception")["footstep_converter"] == "ready"
        pid = row["pid"]
        assert "not acknowledged" in up.valorctl("operator", "restart", "link_robot", expect=1)
        assert "not acknowledged" in up.status("operator")["hosts"][0]["problem"]
    finally:
        up.network.plug("operator")
    wait_until(lambda: healthy(up, "perception"), 60.0, "the ends hear each other again")
    wait_until(lambda: healthy(up, "operator"), 60.0, "they do")
    assert {row["name"]: row["pid"] for row in up.status("motion")["services"]}["link_robot"] == pid, "it was done late"


def test_down_ends_both_networks_the_robots_first(up: Hosts) -> None:
    said = up.valorctl("operator", "down")
    assert said.index("ended: footstep_converter") < said.index("instance 'trio' is down on operator")
    wait_until(lambda: not any(map(up.left, up.network.addresses)), 30.0, "nothing is left on any")
    assert "was not up" in up.valorctl("operator", "down", "--deployment", str(up.file))
