"""Tables: values are checked when read; an error names file, key and expectation in one line."""

import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta, field

from valor.common.errors import ConfigurationError
from valor.common.table import NonNegative, Positive, Table, TableError, checked, plain, read


class Joint(Table):
    limit: Positive
    gains: dict[str, NonNegative] = field(default_factory=dict)
    mode: Literal["force", "position"] = "force"
    rate: Annotated[float, Meta(ge=100, le=1000, extra={"unit": "Hz"})] | None = None

    def __post_init__(self) -> None:
        if self.mode == "force" and self.limit > 50:
            raise TableError(("limit",), "too much for force")


class Lidar(Table, tag_field="kind", tag="lidar"):
    rate: Positive


class Camera(Table, tag_field="kind", tag="camera"):
    width: int = 640


class Robot(Table, kw_only=True):
    name: str = "escher"
    joints: dict[str, Joint]
    spare: list[Joint] = field(default_factory=list)
    sides: dict[Literal["left", "right"], float] = field(default_factory=dict)
    folder: Path | None = None
    drive: Literal["sea", "harmonic"] | None = None
    devices: dict[str, Lidar | Camera] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.name in self.joints:
            raise TableError(("name",), f"{self.name} is a joint's")


KNEE, HIP = {"limit": 12}, {"limit": 9.5, "gains": {"p": 1}}
GOOD: dict[str, Any] = {"joints": {"hip": HIP, "knee": KNEE}}


def test_values_are_taken_as_their_types_and_given_back() -> None:
    robot = checked(
        Robot,
        GOOD
        | {"folder": "/tmp", "spare": [KNEE], "sides": {"left": 1}, "devices": {"top": {"kind": "lidar", "rate": 40}}},
    )
    assert robot.joints["knee"] == Joint(limit=12.0) and robot.folder == Path("/tmp")
    assert checked(Robot, plain(robot)) == robot
    with pytest.raises(AttributeError):
        robot.name = "thor"


@pytest.mark.parametrize(
    ("change", "key", "what"),
    [
        ({"joints": {"hip": HIP, "knee": {"limit": 0}}}, "joints.knee.limit", "expected float > 0.0, got 0"),
        ({"joints": {"hip": HIP, "knee": {"limit": "12"}}}, "joints.knee.limit", "expected float, got '12'"),
        ({"joints": {"hip": HIP, "knee": {}}}, "joints.knee.limit", "expected, but missing"),
        ({"joints": {"hip": HIP, "knee": None}}, "joints.knee", "expected a mapping, got nothing"),
        ({"joints": {"knee": KNEE | {"gain": 1}}}, "joints.knee.gain", "unknown key; did you mean 'gains'?"),
        ({"joints": {"knee": KNEE | {"mode": "magic"}}}, "joints.knee.mode", "expected force or position, got 'magic'"),
        ({"joints": {"knee": KNEE | {"rate": 7}}}, "joints.knee.rate", "expected float >= 100.0 Hz, got 7"),
        ({"joints": {"knee": {"limit": math.nan}}}, "joints.knee.limit", "expected a finite number, got nan"),
        ({"spare": KNEE}, "spare", "expected a list, got a mapping"),
        ({"sides": {"left": 1, "up": 2}}, "sides", "expected left or right, got 'up'"),
        ({"drive": "steam"}, "drive", "expected harmonic or sea, got 'steam'"),
        ({"folder": 7}, "folder", "expected a path, got 7"),
        ({"spare": [KNEE, KNEE | {"mode": "force", "limit": 99}]}, "spare.1.limit", "too much for force"),
        (
            {"devices": {"a": {"kind": "camera"}, "b": {"kind": "sonar"}}},
            "devices.b.kind",
            "expected camera or lidar, got 'sonar'",
        ),
        ({"devices": {"a": {"kind": "camera"}, "b": {"rate": 1}}}, "devices.b.kind", "expected, but missing"),
    ],
)
def test_errors_name_the_key(change: dict[str, Any], key: str, what: str) -> None:
    content = GOOD | change
    before = repr(content)
    with pytest.raises(TableError) as refused:
        checked(Robot, content)
    assert (refused.value.key, refused.value.what) == (key, what)
    assert repr(content) == before, "what was given has been changed"


json = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["limit", "gains", "a.b", "["]), inner),
    max_leaves=8,
)


@given(st.dictionaries(st.sampled_from(["name", "joints", "spare", "sides", "folder", "drive"]), json) | json)
def test_any_content_gives_a_table_or_an_error(content: object) -> None:
    try:
        assert isinstance(checked(Robot, content), Robot)
    except TableError as error:
        assert str(error)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"{", ":2:1: (whole file): not YAML"),
        (b"name: escher\n\xff", ":2: expected text in UTF-8, got byte 0xff"),
        (b"name: escher\njoints: 3", ":2:1: joints: expected a mapping, got 3"),
        (b"joints: {hip: {limit: 2, mode: slow}}", ":1:26: joints.hip.mode: expected force or position, got 'slow'"),
        (b"joints: {}\nspare:\n  - limit: 1\n  - mode: force", ":4:5: spare.1.limit: expected, but missing"),
        (b"name: knee\njoints: {knee: {limit: 1}}", ":1:1: name: knee is a joint's"),
    ],
)
def test_a_file_that_cannot_be_read_is_named_in_one_line(tmp_path: Path, text: bytes, words: str) -> None:
    file = tmp_path / "robot.yaml"
    file.write_bytes(text)
    for wrong, reported in ((file, words), (tmp_path / "none.yaml", "No such file")):
        with pytest.raises(ConfigurationError, match=re.escape(reported)) as refused:
            read(Robot, wrong)
        assert str(wrong) in str(refused.value) and "\n" not in str(refused.value)
