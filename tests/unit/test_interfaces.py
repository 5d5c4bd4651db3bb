"""The ROS twins agree with the Bifrost messages, and the compiled wheel with its sources."""

import re
import sys
import tomllib
from pathlib import Path

import pytest

from bifrost import Message, codec
from harness.places import REPOSITORY
from valor.common.messages import JointMode
from valor.common.topics import TOPICS

INTERFACES = REPOSITORY / "interfaces"
TWINS = INTERFACES / "valor_msgs" / "msg"
HEADER = [("std_msgs/Header", "header"), ("uint64", "bifrost_sequence")]
ROS_TYPES = {
    "bool": "bool", "int": "int64", "float": "float64", "str": "string", "list<str>": "string[]",
    "float64[]": "float64[]", "uint8[]": "uint8[]",
}  # fmt: skip


def twin_fields(file: Path) -> tuple[list[tuple[str, str]], dict[str, str]]:
    """Fields (type, name) and constants (name, value) of a .msg file, in its order."""
    fields: list[tuple[str, str]] = []
    constants: dict[str, str] = {}
    for line in file.read_text().splitlines():
        words = line.partition("#")[0].split()
        if "=" in words:
            constants[words[1]] = words[3]
        elif words:
            fields.append((words[0], words[1]))
    return fields, constants


def published() -> list[type[Message]]:
    return sorted({topic.type for topic in TOPICS}, key=lambda message: message.__name__)


@pytest.mark.parametrize("message", published(), ids=lambda message: message.__name__)
def test_every_published_message_has_a_twin_of_the_same_fields(message: type[Message]) -> None:
    described = codec(message).schema.types[message.__name__]
    expected = HEADER + [(ROS_TYPES[type_name], name) for name, type_name in described]
    fields, _ = twin_fields(TWINS / f"{message.__name__}.msg")
    assert fields == expected


def test_no_twin_has_lost_its_message() -> None:
    assert {file.stem for file in TWINS.glob("*.msg")} == {message.__name__ for message in published()}


def test_the_joint_modes_have_the_same_numbers() -> None:
    _, constants = twin_fields(TWINS / "Motor.msg")
    assert constants == {mode.name: str(mode.value) for mode in JointMode}


@pytest.mark.parametrize("package", sorted(file.parent.name for file in INTERFACES.glob("*/package.xml")))
def test_the_installed_wheel_is_the_one_of_these_sources(package: str) -> None:
    installed = Path(sys.prefix) / "share" / package
    sources = {
        str(file.relative_to(INTERFACES / package)): file.read_text()
        for folder in ("msg", "srv", "action")
        for file in (INTERFACES / package / folder).glob("*.*")
    }
    assert sources
    assert {name: (installed / name).read_text() for name in sources} == sources, "run `make setup`"


def test_the_build_uses_the_message_packages_that_run() -> None:
    def versions(file: Path) -> dict[str, str]:
        return dict(re.findall(r"^(ros-[a-z0-9-]+)==([0-9.]+)", file.read_text(), re.MULTILINE))

    built, runs = versions(INTERFACES / "build-constraints.txt"), versions(REPOSITORY / "requirements.txt")
    common = built.keys() & runs.keys()
    assert {"ros-std-msgs", "ros-rosidl-runtime-c", "ros-rosidl-typesupport-fastrtps-c"} <= common
    assert {name: built[name] for name in common} == {name: runs[name] for name in common}
    constraints = (INTERFACES / "build-constraints.txt").read_text()
    for requirement in tomllib.loads((INTERFACES / "pyproject.toml").read_text())["build-system"]["requires"]:
        assert re.search(rf"^{re.escape(requirement)} ", constraints, re.MULTILINE), requirement
