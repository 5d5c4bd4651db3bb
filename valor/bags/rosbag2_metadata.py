"""rosbag2's ``metadata.yaml`` (version 9, ROS 2 Jazzy), which describes the MCAP files of a folder as one bag.

It is derived from the indices of the files, so it can be written again at any time.
"""

import contextlib
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from valor.bags.errors import BagError
from valor.bags.files import SUFFIX, is_own_folder
from valor.bags.index import BagIndex, read_index
from valor.common import whole_file

EVENT = "event"  # name of an event's metadata record: ``what``, ``stamp_ns`` (recorder's wall clock), ``reason``
FILE = "metadata.yaml"
VERSION, DISTRIBUTION = 9, "jazzy"
_TOPICS = "topics_with_message_count"


@dataclass(frozen=True)
class Head:
    """The head of ``metadata.yaml``."""

    start: float  # of the first message, wall clock [s]
    duration: float  # from the first message to the last [s]
    messages: int  # number of messages
    events: dict[str, str]  # descriptions by time (ISO 8601)


def head(folder: Path) -> Head | None:
    """Read ``metadata.yaml`` up to its long list of topics; None if it is absent or malformed."""
    lines = []
    try:
        with open(folder / FILE) as file:
            for line in file:
                if line.strip() == f"{_TOPICS}:":
                    break
                lines.append(line)
        found = yaml.safe_load("".join(lines))["rosbag2_bagfile_information"]
        return Head(
            found["starting_time"]["nanoseconds_since_epoch"] * 1e-9,
            found["duration"]["nanoseconds"] * 1e-9,
            found["message_count"],
            {str(when): str(what) for when, what in (found.get("custom_data") or {}).items()},
        )
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError):
        return None


def write(folder: Path) -> Path | None:
    """Describe the finished bags named as their folder; returns the file, None without bags. Raises ``OSError``."""
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
    """A dumper without anchors."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def _index(file: Path) -> BagIndex | None:
    """The index of a bag; None if the bag is not finished."""
    try:
        return read_index(file)
    except (BagError, OSError):
        return None


def _events(found: list[tuple[Path, BagIndex]]) -> dict[str, str] | None:
    """Descriptions of events by time, for rosbag2's ``custom_data``."""
    events = {}
    for record in (record for _, index in found for record in index.metadata if record.name == EVENT):
        with contextlib.suppress(KeyError, ValueError, OverflowError):  # another program's, or outside the calendar
            values = record.metadata
            when = datetime.fromtimestamp(int(values["stamp_ns"]) * 1e-9).astimezone()
            events[when.isoformat(timespec="milliseconds")] = f"{values['what']}: {values['reason']}"
    return events or None


def _topics(found: list[tuple[Path, BagIndex]]) -> list[dict[str, Any]]:
    topics: dict[tuple[str, str], dict[str, Any]] = {}
    for _, index in found:
        for channel in index.channels.values():
            schema = index.schemas.get(channel.schema_id)
            type_name = schema.name if schema else ""
            described = {
                "name": channel.topic,
                "type": type_name,
                "serialization_format": channel.message_encoding,
                "offered_qos_profiles": yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or [],
                "type_description_hash": channel.metadata.get("topic_type_hash", ""),
            }
            topic = topics.setdefault((channel.topic, type_name), {"topic_metadata": described, "message_count": 0})
            topic["message_count"] += index.statistics.channel_message_counts.get(channel.id, 0)
    return [topics[key] for key in sorted(topics)]


def _information(found: list[tuple[Path, BagIndex]]) -> dict[str, Any]:
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
        _TOPICS: _topics(found),
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file, _ in found],
        "files": files,
        "ros_distro": DISTRIBUTION,
    }
