"""Deployment files: their content, and faults by file, line and key."""

from pathlib import Path

import pytest

from valor.common.errors import ConfigurationError
from valor.common.processes import DAEMON
from valor.common.resources import file_of, names
from valor.valorctl.hosts.deployment import Deployment

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
  relay: 10.9.0.2:9000
"""


def load(folder: Path, text: str) -> Deployment:
    file = folder / "two.yaml"
    file.write_text(text)
    return Deployment.load(file)


def test_each_deployment_of_the_product_is_valid() -> None:
    for name in names("deployment"):
        found = Deployment.load(file_of("deployment", name))
        assert found.name == name
        assert {DAEMON, "comms_manager", "motion_manager", "valor_ros_controller"} <= set(found.processes)
    with pytest.raises(ConfigurationError, match=r"deployment 'dcr'.*did you mean 'drc'"):
        file_of("deployment", "dcr")


def test_options_add_processes_here_and_remove_others(tmp_path: Path) -> None:
    found = load(tmp_path, GOOD)
    hosts = {host.name: host for host in found.table("motion", also=["foxglove_bridge"], but=["bag_recorder"])}
    assert hosts["motion"].processes == ("comms_manager", "motion_manager", "foxglove_bridge")
    assert hosts["other"].processes == ("valor_ros_controller", "footstep_converter")


@pytest.mark.parametrize(
    ("before", "after", "complaint"),
    [
        ("10.0.0.2", "10.0.0.1", r"two\.yaml:7:\d+: hosts\.other\.address: got 10\.0\.0\.1, the address of motion"),
        ("10.0.0.2", "127.0.0.1", r"hosts\.other\.address: got 127\.0\.0\.1; expected an address through which"),
        ("bag_recorder", "bag_recoder", r"two\.yaml:8:\d+: hosts\.other\.processes\.2: .*did you mean 'bag_recorder'"),
        ("bag_recorder", "bifrostd", r"hosts\.other\.processes\.2: got bifrostd, which runs on every host"),
        ("bag_recorder", "motion_manager", r"hosts\.other\.processes\.2: got 'motion_manager', which runs on motion"),
        (", bag_recorder", "", r"two\.yaml:\d+:\d+: hosts: bag_recorder of profile sim: expected on one of the hosts"),
        ("bag_recorder]", "bag_recorder, device_emulators]", r"processes\.3: got device_emulators"),
        ("address: 10.0.0.2", "address: 10.0.0.2\n    ssh: -v x", r"hosts\.other\.ssh: got '-v x'; expected a "),
        (": two computers", ": d\nssh: {config: none}", r"two\.yaml:2:\d+: ssh\.config: \S+none: no such"),
        ("  other:", "  Other:", r"hosts\.Other: expected lower-case letters"),
        (GOOD, "description: none\nhosts: {}\n", r"hosts: "),
        ("operators: [desk]", "operators: [dsk]", r"two\.yaml:10:\d+: link\.operators\.0: .*did you mean 'desk'"),
        ("[link_operator]", "[]", r"two\.yaml:9:\d+: link: expected link_operator on one of the hosts"),
        (", link_robot]", "]", r"two\.yaml:9:\d+: link: expected link_robot on one of the hosts"),
        ("[desk]", "[motion, desk]", r"two\.yaml:5:\d+: hosts\.motion\.processes\.0: got comms_manager, .*only"),
        ("10.9.0.2:9000", "10.9.0.2", r"two\.yaml:11:\d+: link\.relay: got '10\.9\.0\.2'; expected ADDRESS:PORT"),
        ("relay: 10.9.0.2:9000", "address: robot", r"link\.address: got 'robot'; expected an IPv4 address"),
        ("relay: 10.9.0.2:9000", "domain: 200", r"two\.yaml:11:\d+: link\.domain: .*101"),
        ("link:\n  operators: [desk]\n  relay: 10.9.0.2:9000\n", "", r"two\.yaml:5:.*got link_robot; .*`link:`"),
    ],
)
def test_faults_are_named(tmp_path: Path, before: str, after: str, complaint: str) -> None:
    text = GOOD if before in GOOD else LINKED
    assert before in text
    with pytest.raises(ConfigurationError, match=complaint):
        load(tmp_path, text.replace(before, after))


def test_processes_that_belong_together_need_one_host(tmp_path: Path) -> None:
    text = GOOD.replace("bag_recorder]", "bag_recorder, operator_stop]")
    text = text.replace("motion_manager]", "motion_manager, operator_station]")
    with pytest.raises(ConfigurationError, match=r":8:.*operator_stop; expected it on the host of operator_st"):
        load(tmp_path, text)


def test_a_link_has_two_networks(tmp_path: Path) -> None:
    found = load(tmp_path, LINKED)
    assert [(host.name, host.operator) for host in found.table("motion")] == [("motion", False), ("desk", True)]
    link = found.link_settings
    assert (link.listen, link.port, link.robot, link.slow, link.fast) == ("10.0.0.1", 7312, "10.9.0.2", 9000, 9001)
    direct = load(tmp_path, LINKED.replace("relay: 10.9.0.2:9000", "address: 10.9.0.1"))
    link = direct.link_settings
    assert (link.listen, link.robot, link.slow, link.fast) == ("10.9.0.1", "10.9.0.1", 7312, 7313)


def test_names_of_the_link_until_version_0_4_are_read(tmp_path: Path) -> None:
    old = LINKED.replace("relay:", "through:") + "  when_lost: stop\n  lost_after: 4\n"
    new = LINKED + "  on_operator_lost: stop\n  operator_timeout: 4\n"
    assert load(tmp_path, old).link_settings == load(tmp_path, new).link_settings


def test_both_sides_have_the_secret_of_the_links_key_file(tmp_path: Path) -> None:
    found = load(tmp_path, LINKED)
    assert load(tmp_path, GOOD).link_secret("one") is None
    with pytest.raises(ConfigurationError, match=r"two\.key: No such file .*head -c 32 /dev/urandom > \S*two\.key"):
        found.link_secret("one")
    key = tmp_path / "two.key"
    for content, mode, complaint in ((b"x" * 32, 0o640, "mode 0640; expected 0600"), (b"x" * 31, 0o600, "31 bytes")):
        key.write_bytes(content)
        key.chmod(mode)
        with pytest.raises(ConfigurationError, match=complaint):
            found.link_secret("one")
    key.write_bytes(b"x" * 32)
    assert found.link_secret("one") == load(tmp_path, LINKED).link_secret("one") != found.link_secret("two")
