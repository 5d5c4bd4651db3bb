"""``metadata.yaml``: what rosbag2 wants to know of the MCAP files in a folder before it opens the folder as one bag.

A recording that stands in a folder of its own name has it (version 9, that of ROS 2 Jazzy); it is made of the files'
own indices, so that it can be written anew at any time.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from valor.bags.errors import BagError
from valor.bags.event import EVENT, Event
from valor.bags.files import SUFFIX, is_own_folder
from valor.bags.index import BagIndex, read_index, read_metadata
from valor.common import whole_file

FILE = "metadata.yaml"
VERSION, DISTRIBUTION = 9, "jazzy"
_TOPICS = "topics_with_message_count"


@dataclass(frozen=True)
class Head:
    """What ``metadata.yaml`` says of a recording as a whole.

    Attributes:
        start: of the first message, wall clock [s].
        duration: from the first message to the last [s].
        messages: how many.
        events: what happened, by when (ISO 8601).
    """

    start: float
    duration: float
    messages: int
    events: dict[str, str]


def head(folder: Path) -> Head | None:
    """What stands in ``metadata.yaml`` before its long list of topics; None: there is none that we can read."""
    lines = []
    try:
        with open(folder / FILE) as file:
            for line in file:
                if line.strip() == f"{_TOPICS}:":
                    break
                lines.append(line)
        said = yaml.safe_load("".join(lines))["rosbag2_bagfile_information"]
        return Head(
            said["starting_time"]["nanoseconds_since_epoch"] * 1e-9,
            said["duration"]["nanoseconds"] * 1e-9,
            said["message_count"],
            {str(when): str(what) for when, what in (said.get("custom_data") or {}).items()},
        )
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError):
        return None


def write(folder: Path) -> Path | None:
    """Describe the finished bags of a folder that have its name; returns the file, or None if there is none.

    Raises:
        OSError: it cannot be written.
    """
    own = (file for file in folder.glob(f"*{SUFFIX}") if is_own_folder(file))
    found = [(file, index) for file in own if (index := _index(file)) is not None]
    if not found:
        return None
    found.sort(key=lambda each: (each[1].statistics.message_start_time, each[0].name))
    target = folder / FILE
    content: str = yaml.dump({"rosbag2_bagfile_information": _information(found)}, None, _Plain, sort_keys=False)
    whole_file.write(target, content)
    return target


class _Plain(yaml.SafeDumper):
    """Without anchors: equal parts are written out."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def _index(file: Path) -> BagIndex | None:
    """A bag's index; None: it has none, because it is not finished."""
    try:
        return read_index(file)
    except (BagError, OSError):
        return None


def _events(found: list[tuple[Path, BagIndex]]) -> dict[str, str] | None:
    """What happened, by when: rosbag2's place for what is not its own."""
    events = {}
    for file, index in found:
        for record in read_metadata(file, index, EVENT):
            if (event := Event.of(record)) is None:
                continue
            with contextlib.suppress(ValueError, OverflowError):  # a time that no calendar has
                when = datetime.fromtimestamp(event.stamp * 1e-9).astimezone()
                events[when.isoformat(timespec="milliseconds")] = event.text
    return events or None


def _information(found: list[tuple[Path, BagIndex]]) -> dict[str, Any]:
    topics: dict[tuple[str, str], dict[str, Any]] = {}
    for _, index in found:
        counts = index.statistics.channel_message_counts
        for channel in index.summary.channels.values():
            schema = index.summary.schemas.get(channel.schema_id)
            type_name = schema.name if schema else ""
            topic = topics.setdefault(
                (channel.topic, type_name),
                {
                    "topic_metadata": {
                        "name": channel.topic,
                        "type": type_name,
                        "serialization_format": channel.message_encoding,
                        "offered_qos_profiles": yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or [],
                        "type_description_hash": channel.metadata.get("topic_type_hash", ""),
                    },
                    "message_count": 0,
                },
            )
            topic["message_count"] += counts.get(channel.id, 0)
    files = [
        {
            "path": file.name,
            "starting_time": {"nanoseconds_since_epoch": index.statistics.message_start_time},
            "duration": {"nanoseconds": index.statistics.message_end_time - index.statistics.message_start_time},
            "message_count": index.statistics.message_count,
        }
        for file, index in found
    ]
    held = [index.statistics for _, index in found if index.statistics.message_count]
    start = min((each.message_start_time for each in held), default=0)
    end = max((each.message_end_time for each in held), default=0)
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(each.message_count for each in held),
        "custom_data": _events(found),
        _TOPICS: [topics[key] for key in sorted(topics)],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file, _ in found],
        "files": files,
        "ros_distro": DISTRIBUTION,
    }
