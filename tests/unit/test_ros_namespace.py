"""Namespaces, and the ROS domains that instances share by them."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace

from harness.places import ROBOTS
from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance, Settings, ros_namespace
from valor.common.table import checked
from valor.ros.topics import shown
from valor.valorctl import middleware, ros_domain


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


def test_rcl_would_refuse_some_of_them_only_when_the_node_starts() -> None:
    with pytest.raises(InvalidNamespaceException):
        validate_namespace("/2nd")


def test_a_node_stands_in_the_namespace_with_its_frames_and_its_time() -> None:
    settings = Settings(robot=Path(), ros_domain_id=1, namespace="lab/a")
    assert settings.frame_prefix == "lab/a/"
    assert {"__ns:=/lab/a", "/clock:=/lab/a/clock"} <= {*settings.ros_arguments}
    alone = Settings(robot=Path(), ros_domain_id=1)
    assert alone.frame_prefix == "" and alone.ros_arguments == ()


@pytest.mark.parametrize(
    ("topic", "ours"),
    [
        ("/a/joint_states", True),
        ("/b/joint_states", False),
        ("/a/b/c", True),
        ("/ab/c", False),
        ("/tf", True),
        ("/a/_b", False),
    ],
)
def test_what_stands_in_another_namespace_is_not_ours(topic: str, ours: bool) -> None:
    assert shown(topic, "a") is ours
    assert shown(topic) is ("/_" not in topic)


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
    monkeypatch.setattr(middleware, "interface", {"10.0.0.2": "10.0.0.1", "10.0.0.3": "10.0.0.1"}.__getitem__)
    assert middleware.addresses(["10.0.0.2", "10.0.0.3", "10.0.0.2"]) == ("10.0.0.2", "10.0.0.3")
    root = ElementTree.fromstring(middleware.profile(["10.0.0.2", "10.0.0.3"]))

    def told(name: str) -> list[str | None]:
        (element,) = root.iter(f"{{http://www.eprosima.com}}{name}")
        return [each.text for each in element.iter("{http://www.eprosima.com}address")]

    assert told("interfaceWhiteList") == ["127.0.0.1", "10.0.0.1"]
    assert told("initialPeersList") == ["127.0.0.1", "10.0.0.2", "10.0.0.3"]


@pytest.mark.parametrize(
    ("peer", "words"),
    [
        ("", "''"),
        ("a b", "expected a computer's name"),
        ("-x", "expected"),
        ("127.0.0.1", "is this computer"),
        ("no.invalid", "no.invalid: "),
    ],
)
def test_what_is_no_peer_is_refused(peer: str, words: str) -> None:
    with pytest.raises(ConfigurationError, match=re.escape(words)) as error:
        middleware.addresses([peer])
    assert "\n" not in str(error.value)
