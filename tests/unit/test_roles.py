"""Code goes by roles, groups and geometry: no name of a robot's joint, body or site stands in it."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

from harness.places import REPOSITORY, ROBOTS

FOLDERS = ("bifrost", "examples", "harness", "services", "thesis", "valor")
NAMED = {
    "valor/ros/limbs.py": "ROS topics that Team ViGIR called so",
    "examples/stand_and_reach.py": "a client that knows no robot.yaml guesses by usual names, and can be told",
    "harness/analysis_bag.py": "a recording of ESCHER",
}
"""Files that may, and why."""
_SIDE = {"l", "r"}


def _names() -> set[str]:
    """Of joints, bodies and sites of our robots; one word alone, as head or chest, is nobody's name."""
    found = (
        element.get("name", "")
        for model in ROBOTS.glob("*/model.xml")
        for element in ElementTree.parse(model).iter()
        if element.tag in ("joint", "body", "site")
    )
    return {name for name in found if "_" in name}


NAMES = _names()
WORDS = {word for name in NAMES for word in name.split("_") if len(word) > 2} | _SIDE
SEARCHES = ("startswith", "endswith", "removeprefix", "removesuffix")
FILES = sorted(
    str(file.relative_to(REPOSITORY))
    for folder in FOLDERS
    for file in (REPOSITORY / folder).rglob("*.py")
    if "robot_setup" not in file.parts
)


def _found(source: str) -> Iterator[str]:
    """Names in texts, and parts of names that others are searched for; not what is said of the code."""
    tree = ast.parse(source)
    said = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    whole = re.compile(rf"(?<![A-Za-z0-9_])({'|'.join(map(re.escape, sorted(NAMES)))})(?![A-Za-z0-9_])")
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in said:
            yield from whole.findall(node.value)
        searched: list[ast.expr] = []
        if isinstance(node, ast.Compare) and isinstance(node.ops[0], (ast.In, ast.NotIn)):
            searched = [node.left]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in SEARCHES:
            searched = node.args
        for each in searched:
            if isinstance(each, ast.Constant) and isinstance(each.value, str) and each.value.strip("_") in WORDS:
                yield each.value


@pytest.mark.parametrize("file", FILES)
def test_no_robots_names_stand_in_code(file: str) -> None:
    found = set(_found(Path(REPOSITORY / file).read_text()))
    assert not found or file in NAMED, sorted(found)


@pytest.mark.parametrize(
    "source", ['x = "l_knee_pitch"', 'y = "knee" in name', 'z = name.startswith("l_")', 'f"/tf/{a}/r_sole"']
)
def test_names_are_found(source: str) -> None:
    assert list(_found(source))
