"""Deployment files: what they say, and what is refused, by file, line and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from valor.common.errors import ConfigurationError
from valor.common.processes import DAEMON
from valor.common.resources import deployments
from valor.valorctl.hosts.deployment import Deployment, deployment_file

GOOD = """\
description: two computers
hosts:
  motion:
    address: 10.0.0.1
    processes: [comms_manager, motion_manager]
  other:
    address: 10.0.0.2
    processes: [valor_ros_controller, footstep_converter, bag_recorder]
"""


def load(folder: Path, text: str) -> Deployment:
    file = folder / "two.yaml"
    file.write_text(text)
    return Deployment.load(file)


def test_each_of_ours_is_whole() -> None:
    for name in deployments():
        found = Deployment.load(deployment_file(name))
        assert found.name == name
        assert {DAEMON, "comms_manager", "motion_manager", "valor_ros_controller"} <= set(found.processes)


def test_options_add_here_and_take_away(tmp_path: Path) -> None:
    found = load(tmp_path, GOOD)
    hosts = {host.name: host for host in found.table("motion", also=["foxglove_bridge"], but=["bag_recorder"])}
    assert hosts["motion"].processes == ("comms_manager", "motion_manager", "foxglove_bridge")
    assert hosts["other"].processes == ("valor_ros_controller", "footstep_converter")


@pytest.mark.parametrize(
    ("before", "after", "complaint"),
    [
        ("10.0.0.2", "10.0.0.1", r"two\.yaml:7:\d+: hosts\.other\.address: got 10\.0\.0\.1, which is motion's"),
        ("10.0.0.2", "robot", r"two\.yaml:7:\d+: hosts\.other\.address: got 'robot'; expected an IPv4 address"),
        ("10.0.0.2", "127.0.0.1", r"hosts\.other\.address: got 127\.0\.0\.1; expected an address by which"),
        ("bag_recorder", "bag_recoder", r"two\.yaml:8:\d+: hosts\.other\.processes\.2: .*did you mean 'bag_recorder'"),
        ("bag_recorder", "bifrostd", r"hosts\.other\.processes\.2: got bifrostd, which runs on every host"),
        ("bag_recorder", "motion_manager", r"hosts\.other\.processes\.2: got 'motion_manager', which runs on motion"),
        (", bag_recorder", "", r"two\.yaml:\d+:\d+: hosts: bag_recorder of profile sim: expected on one of the hosts"),
        ("bag_recorder]", "bag_recorder, device_emulators]", r"processes\.3: got device_emulators"),
        ("  other:", "  Other:", r"hosts\.Other: expected lower-case letters"),
        ("description: two computers", "description: d\nprofile: simm", r"two\.yaml:2:\d+: profile: .*'sim'"),
        ("    address: 10.0.0.2\n", "", r"hosts\.other\.address: expected, but missing"),
        ("processes: [comms", "proceses: [comms", r"hosts\.motion\.proceses: unknown key; did you mean 'processes'"),
        (GOOD, "description: none\nhosts: {}\n", r"hosts: "),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, before: str, after: str, complaint: str) -> None:
    assert before in GOOD
    with pytest.raises(ConfigurationError, match=complaint):
        load(tmp_path, GOOD.replace(before, after))


def test_what_shares_a_bus_is_on_one_host(tmp_path: Path) -> None:
    text = GOOD.replace("bag_recorder]", "bag_recorder, operator_stop]")
    text = text.replace("motion_manager]", "motion_manager, operator_station]")
    with pytest.raises(
        ConfigurationError, match=r"two\.yaml:8:.*operator_stop; expected it on the host of operator_st"
    ):
        load(tmp_path, text)


LINKED = """\
description: two networks
hosts:
  motion:
    address: 10.0.0.1
    processes: [comms_manager, motion_manager, valor_ros_controller, footstep_converter, bag_recorder, link_robot]
  desk:
    address: 10.0.0.2
    processes: [link_operator]
link:
  operators: [desk]
  through: 10.9.0.2:9000
"""


def test_a_link_has_two_networks(tmp_path: Path) -> None:
    found = load(tmp_path, LINKED)
    assert [(host.name, host.operator) for host in found.table("motion")] == [("motion", False), ("desk", True)]
    link = found.link_settings
    assert (link.listen, link.port, link.robot, link.slow, link.fast) == ("10.0.0.1", 7312, "10.9.0.2", 9000, 9001)
    assert (found.beside("motion"), found.beside("desk")) == (("motion",), ("desk",))
    direct = load(tmp_path, LINKED.replace("through: 10.9.0.2:9000", "address: 10.9.0.1"))
    link = direct.link_settings
    assert (link.listen, link.robot, link.slow, link.fast) == ("10.9.0.1", "10.9.0.1", 7312, 7313)


@pytest.mark.parametrize(
    ("before", "after", "complaint"),
    [
        ("operators: [desk]", "operators: [dsk]", r"two\.yaml:10:\d+: link\.operators\.0: .*did you mean 'desk'"),
        ("operators: [desk]", "operators: []", r"two\.yaml:10:\d+: link\.operators: "),
        ("  operators: [desk]\n", "", r"two\.yaml:\d+:\d+: link\.operators: expected, but missing"),
        ("[link_operator]", "[]", r"two\.yaml:9:\d+: link: expected link_operator on one of the hosts"),
        (", link_robot]", "]", r"two\.yaml:9:\d+: link: expected link_robot on one of the hosts"),
        ("[desk]", "[motion, desk]", r"two\.yaml:5:\d+: hosts\.motion\.processes\.0: got comms_manager, .*alone"),
        ("[desk]", "[motion]", r"hosts\.motion\.processes\.\d: got "),
        ("10.9.0.2:9000", "10.9.0.2", r"two\.yaml:11:\d+: link\.through: got '10\.9\.0\.2'; expected ADDRESS:PORT"),
        ("10.9.0.2:9000", "10.9.0.2:99999", r"link\.through: got '10\.9\.0\.2:99999'; expected ADDRESS:PORT"),
        ("through: 10.9.0.2:9000", "address: robot", r"link\.address: got 'robot'; expected an IPv4 address"),
        ("through: 10.9.0.2:9000", "domain: 200", r"two\.yaml:11:\d+: link\.domain: .*101"),
        ("through: 10.9.0.2:9000", "when_lost: sit", r"two\.yaml:11:\d+: link\.when_lost: .*'sit'"),
        ("link:\n  operators: [desk]\n  through: 10.9.0.2:9000\n", "", r"two\.yaml:5:.*got link_robot; .*`link:`"),
    ],
)
def test_what_is_wrong_with_a_link_is_named(tmp_path: Path, before: str, after: str, complaint: str) -> None:
    assert before in LINKED
    with pytest.raises(ConfigurationError, match=complaint):
        load(tmp_path, LINKED.replace(before, after))


def test_no_such_deployment_lists_ours() -> None:
    with pytest.raises(ConfigurationError, match=r"deployment 'dcr'.*did you mean 'drc'"):
        deployment_file("dcr")
