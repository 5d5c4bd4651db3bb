"""Generator of texts from tables and messages: tables of the documentation, import contracts, ROS mirror types.

``make tables`` writes them, and links the services' folders into ``valor``; a test detects stale ones.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterable, Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any

from bifrost import Message, codec
from harness.places import REPOSITORY
from valor.common.behaviors import BEHAVIOR_TRANSITIONS, INTERNAL_STATES
from valor.common.messages import JointMode, Motor
from valor.common.processes import DAEMON, PROCESSES
from valor.common.topics import CONTROL_RATE, SERVICE_TOPICS, STATISTICS, TOPICS, Topic

TWINS = REPOSITORY / "interfaces" / "valor_msgs" / "msg"
ROS_TYPES = {
    "bool": "bool",
    "int": "int64",
    "float": "float64",
    "str": "string",
    "list<str>": "string[]",
    "float64[]": "float64[]",
    "uint8[]": "uint8[]",
}
_MODULES = [process.module for process in PROCESSES if process.name != DAEMON]
CONSTANTS: dict[type[Message], type[IntEnum]] = {Motor: JointMode}
_HEADER = """\
std_msgs/Header header    # stamp: publication on the wall clock; frame_id: empty, frames are in names
uint64 bifrost_sequence
"""


def twin(message: type[Message]) -> str:
    """The ``.msg`` of a message's ROS mirror type: docstring, header, fields with comments."""
    source = textwrap.dedent(inspect.getsource(message))
    definition = ast.parse(source).body[0]
    assert isinstance(definition, ast.ClassDef)
    lines = source.splitlines()
    comments = {
        node.target.id: lines[(node.end_lineno or 0) - 1].partition("  # ")[2]
        for node in definition.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
    fields = [
        (f"{ROS_TYPES[type_name]} {name}", comments[name])
        for name, type_name in codec(message).schema.types[message.__name__]
    ]
    width = max((len(field) for field, comment in fields if comment), default=0)
    blocks = [
        "".join(f"# {line}".rstrip() + "\n" for line in inspect.cleandoc(message.__doc__ or "").splitlines()),
        _HEADER,
        "".join(f"uint8 {each.name} = {each.value}\n" for each in CONSTANTS.get(message, ())),
        "".join(f"{field:{width}}  # {comment}\n" if comment else f"{field}\n" for field, comment in fields),
    ]
    return "\n".join(filter(None, blocks))


def processes() -> str:
    """Table of processes."""
    rows = []
    for each in PROCESSES:
        notes = ("; hardware only" if each.hardware_only else "") + (f"; `up {each.option}`" if each.option else "")
        budgets = (f"{each.cpu_budget:g}", f"{each.memory_budget:g}")
        rows.append((f"`{each.name}`", each.description + notes, _names((*each.needs, *each.after)), *budgets))
    return _table(("process", "does", "starts after", "CPU [% of a core]", "memory [MiB]"), rows)


def topics() -> str:
    """Table of Bifrost topics; topics that differ in one part of their names only are one row."""
    alike: dict[tuple[Any, ...], list[Topic[Any]]] = {}
    for each in TOPICS:
        alike.setdefault((each.type, each.rate, each.record_every, each.latched, each.description), []).append(each)
    rows = []
    for family in alike.values():
        first = family[0]
        publishers = _names(tuple(dict.fromkeys(name for each in family for name in each.publishers)))
        recorded = {0: "no", 1: "all"}.get(first.record_every, f"1 of {first.record_every}")
        description = first.description + ("; latched" if first.latched else "")
        name, kind = _common_name(family), first.type.__name__
        rows.append((f"`{name}`", f"`{kind}`", publishers, _rate(first), recorded, description))
    return _table(("topic", "type", "published by", "rate [Hz]", "recorded", ""), rows)


def _common_name(family: Sequence[Topic[Any]]) -> str:
    """``a/{b,c}/d`` of ``a/b/d`` and ``a/c/d``."""
    parts = (dict.fromkeys(part) for part in zip(*(each.name.split("/") for each in family), strict=True))
    return "/".join(next(iter(part)) if len(part) == 1 else f"{{{','.join(part)}}}" for part in parts)


def services() -> str:
    """Table of Bifrost services."""
    rows = (
        (
            f"`{each.name}`",
            f"`{each.request.__name__}`",
            f"`{each.reply.__name__}`",
            _names(each.servers),
            each.description,
        )
        for each in SERVICE_TOPICS
    )
    return _table(("service", "request", "reply", "served by", ""), rows)


def behaviors() -> str:
    """Table of behaviors: internal states, and transitions by source."""
    rows = []
    for behavior, row in BEHAVIOR_TRANSITIONS.items():
        sources = sorted(set(row.values()), key=("T", "P", "I", "I2").index)
        to = (f"{source}: {_names([there for there in row if row[there] == source])}" for source in sources)
        rows.append((f"`{behavior}`", _names(INTERNAL_STATES[behavior]), "; ".join(to)))
    return _table(("from", "Locomotion, Manipulation, Attention", "to"), rows)


def layer() -> str:
    """Layer of the services in the import contracts."""
    return f'  "{" | ".join(_MODULES)}",\n'


def insides() -> str:
    """Modules that no tool may import."""
    return "".join(f'  "{each}",\n' for each in _MODULES)


PLACES = {
    processes: "docs/architecture.md",
    topics: "docs/interfaces.md",
    services: "docs/interfaces.md",
    behaviors: "docs/motion_manager.md",
    layer: "pyproject.toml",
    insides: "pyproject.toml",
}
"""File of each text, which is between a comment with its name and the comment ``end``."""


def texts() -> dict[Path, str]:
    """New content of all generated files.

    Raises:
        ValueError: a file lacks the comments around a text.
    """
    made = {TWINS / f"{topic.type.__name__}.msg": twin(topic.type) for topic in TOPICS}
    for written, place in PLACES.items():
        path = REPOSITORY / place
        comment, blank = ("<!-- {} -->\n", "\n") if path.suffix == ".md" else ("  # {}\n", "")
        begin, end = comment.format(f"{written.__name__}: by `make tables`"), comment.format("end")
        before, found, behind = (made.get(path) or path.read_text()).partition(begin)
        _, ended, after = behind.partition(end)
        if not found or not ended:
            raise ValueError(f"{place}: expected {begin.strip()}, then what is written, then {end.strip()}")
        made[path] = f"{before}{begin}{blank}{written()}{blank}{end}{after}"
    return made


def _rate(topic: Topic[Any]) -> str:
    if topic.rate is None:
        return "on change"
    return "control rate" if topic.rate == CONTROL_RATE else f"{topic.rate:g}"


def _names(names: Sequence[str]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "–"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, ["---"] * len(head), *rows))


def link() -> None:
    """Link the folders of all services into ``valor``."""
    for name in STATISTICS:
        path = REPOSITORY / "valor" / name
        if not path.is_symlink():
            path.symlink_to(Path("..") / "services" / name)


if __name__ == "__main__":
    link()
    for path, text in texts().items():
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
            print(path.relative_to(REPOSITORY))
