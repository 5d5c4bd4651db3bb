"""The recorder's ROS parameters, under rosbag2's names where it has them: what a launch file or ``-p`` may set.

Each is what the instance's settings say unless it is set at start. They are read-only then.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
from rclpy.node import Node

from valor.common.errors import ConfigurationError
from valor.common.instance import Recording, Settings
from valor.common.table import checked, plain
from valor.ros.parameters import Parameters, Range

_MOST_BYTES, _MOST_SECONDS = 2**62, 1e9


def settings_of(node: Node, settings: Settings) -> Settings:
    """The settings with what the node's parameters say of the recording.

    Raises:
        ConfigurationError: a parameter was set to what it cannot be; names it and what was expected.
    """
    declare, recording = Parameters(node).declare, settings.recording
    uri = declare(
        "storage.uri", str(settings.bag or ""), "folder or .mcap file to write to; '': a new one in the instance's bags"
    )
    only = declare("record.topics", list(recording.only) or [""], "shell patterns of topics in the bag; '': all")
    without = declare(
        "record.exclude_topics", list(recording.without) or [""], "shell patterns of topics left out of it; '': none"
    )
    size = declare(
        "storage.max_bagfile_size", recording.split_bytes, "the next bag begins after so much [B]",
        Range(1 << 20, _MOST_BYTES),
    )  # fmt: skip
    age = declare(
        "storage.max_bagfile_duration", recording.split_seconds or 0.0,
        "the next bag begins after so long [s], from 1; 0: never for that", Range(0.0, _MOST_SECONDS),
    )  # fmt: skip
    ring = declare(
        "ring_seconds", recording.ring_seconds or 0.0,
        "hold the last seconds, from 1, and write them when asked or on a fall [s]; 0: write everything",
        Range(0.0, 600.0),
    )  # fmt: skip
    for name, value in (("storage.max_bagfile_duration", age), ("ring_seconds", ring)):
        if 0.0 < value < 1.0:
            raise ConfigurationError(f"ROS parameter {name}: {value:g} s; expected 0, or 1 and more")
    changes = {
        "only": [pattern for pattern in only if pattern],
        "without": [pattern for pattern in without if pattern],
        "split_bytes": size,
        "split_seconds": age or None,
        "ring_seconds": ring or None,
    }
    changed = checked(Recording, plain(recording) | changes)
    return msgspec.structs.replace(settings, bag=Path(uri).absolute() if uri else None, recording=changed)
