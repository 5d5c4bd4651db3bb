"""Namespaces, and the ROS domains that instances share by them."""

import itertools
import re
import socket
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.validate_namespace import validate_namespace

from harness.places import ROBOTS
from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance, Settings, ros_namespace
from valor.common.table import checked
from valor.ros.node import Sieve
from valor.ros.topics import shown
from valor.valorctl.instance import ros_domain
from valor.valorctl.instance.ros_domain import DOMAINS, choose, daemon_ports, discovery_port, is_free, is_reserved


@given(st.one_of(st.text(max_size=80), st.from_regex(r"/?[A-Za-z0-9_/]{0,70}", fullmatch=True)))
def test_a_namespace_is_one_of_roses_own_or_refused_in_a_line(text: str) -> None:
    try:
        name = ros_namespace(text)
    except ConfigurationError as error:
        assert str(error).startswith("namespace ") and "\n" not in str(error) and len(str(error)) < 300
        return
    assert name == text.removeprefix("/")
    if name:
        validate_namespace(f"/{name}")
        assert shown(f"/{name}/joint_states"), "hidden topics are not recorded"


@pytest.mark.parametrize(
    "text", ["2nd", "a b", "a//b", "a/", "_a", "a__b", "a/_b", "~", "bifrost", "bifrost/a", "é", "a" * 65, "//a"]
)
def test_what_is_no_namespace_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match="expected letters, digits"):
        ros_namespace(text)
    with pytest.raises(ConfigurationError, match=re.escape(f"namespace '{text[:64]}")):
        checked(Settings, {"robot": "/r", "ros_domain_id": 1, "namespace": text})


def test_a_node_stands_in_the_namespace_with_its_frames_and_its_time() -> None:
    settings = Settings(robot=Path(), ros_domain_id=1, namespace="lab/a")
    assert settings.frame_prefix == "lab/a/" and {"__ns:=/lab/a", "/clock:=/lab/a/clock"} <= {*settings.ros_arguments}
    alone = Settings(robot=Path(), ros_domain_id=1)
    assert alone.frame_prefix == "" and alone.ros_arguments == ()


@pytest.mark.parametrize(
    ("topic", "ours"),
    [
        ("/a/joint_states", True), ("/b/joint_states", False), ("/a/b/c", True), ("/ab/c", False), ("/tf", True),
        ("/a/_b", False),
    ],
)  # fmt: skip
def test_what_stands_in_another_namespace_is_not_ours(topic: str, ours: bool) -> None:
    assert shown(topic, "a") is ours and shown(topic) is ("/_" not in topic)


def test_a_domain_is_shared_and_the_ports_that_go_with_one_are_not(tmp_path: Path) -> None:
    with ros_domain.reserve("some") as free:
        domain = free.domain
    first, second = (Instance(name, tmp_path) for name in "ab")
    with ros_domain.reserve_for(first, domain) as one:
        assert one.domain == domain, "nobody has it"
        first.folder.mkdir()
        settings = Settings(robot=ROBOTS / "escher", ros_domain_id=domain, port_block=one.domain, namespace="a")
        first.settings_file.write_text(settings.json())
        with ros_domain.reserve_for(second, domain) as other:
            assert other.domain != domain
            ros_domain.refuse_namesake(second, domain, "b")
            ros_domain.refuse_namesake(second, other.domain, "a")
            ros_domain.refuse_namesake(first, domain, "a")  # itself
            with pytest.raises(ValorError, match="has instance 'a' with namespace 'a', too; expected another"):
                ros_domain.refuse_namesake(second, domain, "a")
            second.folder.mkdir()
            settings = Settings(robot=ROBOTS / "escher", ros_domain_id=domain, port_block=other.domain, namespace="b")
            second.settings_file.write_text(settings.json())
            assert ros_domain.taken(tmp_path) == {domain, other.domain}


def test_peers_open_the_interfaces_by_which_they_are_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_domain, "interface", {"10.0.0.2": "10.0.0.1", "10.0.0.3": "10.0.0.1"}.__getitem__)
    assert ros_domain.addresses(["10.0.0.2", "10.0.0.3", "10.0.0.2"]) == ("10.0.0.2", "10.0.0.3")
    root = ElementTree.fromstring(ros_domain.peers_profile(["10.0.0.2", "10.0.0.3"]))

    def reported(name: str) -> list[str | None]:
        (element,) = root.iter(f"{{http://www.eprosima.com}}{name}")
        return [each.text for each in element.iter("{http://www.eprosima.com}address")]

    assert reported("interfaceWhiteList") == ["127.0.0.1", "10.0.0.1"]
    assert reported("initialPeersList") == ["127.0.0.1", "10.0.0.2", "10.0.0.3"]


@pytest.mark.parametrize(
    ("peer", "words"),
    [
        ("", "''"), ("a b", "expected a computer's name"), ("-x", "expected"), ("127.0.0.1", "is this computer"),
        ("no.invalid", "no.invalid: "),
    ],
)  # fmt: skip
def test_what_is_no_peer_is_refused(peer: str, words: str) -> None:
    with pytest.raises(ConfigurationError, match=re.escape(words)) as error:
        ros_domain.addresses([peer])
    assert "\n" not in str(error.value)


# The ROS domain of an instance is exclusive on a computer.
@given(st.text(), st.sets(st.sampled_from(list(DOMAINS))), st.sets(st.sampled_from(list(DOMAINS))))
def test_a_free_domain_is_chosen(key: str, taken: set[int], busy: set[int]) -> None:
    if len(taken | busy) == len(DOMAINS):
        with pytest.raises(ValorError, match="no free ROS domain"):
            choose(key, taken, lambda domain: domain not in busy)
        return
    domain = choose(key, taken, lambda domain: domain not in busy)
    assert domain in DOMAINS and domain not in taken | busy
    assert domain == choose(key, taken, lambda domain: domain not in busy)


def test_an_instance_retakes_its_domain_from_ros_clients_but_not_from_instances() -> None:
    with ros_domain.reserve("test") as reservation:
        domain = reservation.domain
        with pytest.raises(ValorError, match=f"ROS domain {domain} is another instance's"):
            ros_domain.retake(domain)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("127.0.0.1", discovery_port(domain)))
        assert not is_free(domain)
        with ros_domain.retake(domain) as again:
            assert again.domain == domain and is_reserved(domain)
    assert is_free(domain)


def test_ports_of_domains_are_disjoint_and_not_ephemeral() -> None:
    ports = [port for domain in (0, *DOMAINS) for port in daemon_ports(domain)]
    assert len(set(ports)) == len(ports) and max(ports) < 32768


def test_domains_of_other_instances_are_taken(tmp_path: Path) -> None:
    for name, content in (("a", '{"ros_domain_id": 5}'), ("b", '{"ros_domain_id": 6}'), ("c", "garbage")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "instance.json").write_text(content)
    assert ros_domain.taken(tmp_path, but=Instance("b", tmp_path)) == {5}


def test_a_process_that_inherits_a_reservation_holds_the_domain(tmp_path: Path) -> None:
    with ros_domain.reserve_for(Instance("x", tmp_path)) as reservation:
        heir = subprocess.Popen(["sleep", "60"], stdin=reservation.fileno())
    try:
        assert is_reserved(reservation.domain)
        with ros_domain.reserve_for(Instance("x", tmp_path)) as other:
            assert other.domain != reservation.domain
    finally:
        heir.kill()
        heir.wait()
    assert not is_reserved(reservation.domain)


# What is let through to /rosout, and what stands for the rest.
class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_the_same_line_passes_seldom_a_kind_more_often_and_no_flood_at_all() -> None:
    clock = Clock()
    sieve = Sieve(clock)
    assert sum(sieve.passes("kind", "text") for _ in range(1000)) == Sieve.ALIKE
    assert sum(sieve.passes("kind", str(i)) for i in range(1000)) == Sieve.OF_A_KIND - Sieve.ALIKE
    assert sum(sieve.passes(str(i), "text") for i in range(1000)) == Sieve.IN_ALL - Sieve.OF_A_KIND
    assert sieve.omitted() == 3000 - Sieve.IN_ALL and sieve.omitted() == 0
    clock.now += Sieve.WINDOW
    assert sieve.passes("kind", "text")


def test_however_long_a_flood_lasts_it_is_bounded_in_lines_and_memory() -> None:
    clock, seconds = Clock(), 20
    sieve = Sieve(clock)
    passed = 0
    for i in itertools.count():
        clock.now = 100.0 + i / 500
        if clock.now >= 100.0 + seconds:
            break
        passed += sieve.passes(i, str(i))
        assert len(sieve._seen) <= 4 * Sieve.IN_ALL
    assert passed <= Sieve.IN_ALL * (seconds + 1) and passed + sieve.omitted() == i
