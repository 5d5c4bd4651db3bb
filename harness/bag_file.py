"""A bag written by another writer than the recorder's."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

SHARE = Path(sys.prefix) / "share"


def type_store(*packages: str) -> Any:
    """ROS Jazzy's types, and the messages of installed packages."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for package in packages:
        for file in sorted((SHARE / package / "msg").glob("*.msg")):
            store.register(get_types_from_msg(file.read_text(), f"{package}/msg/{file.stem}"))
    return store


def write_bag(path: Path, store: Any, rows: Iterable[tuple[int, str, str, Any]]) -> None:
    """Write an MCAP file of rows: wall clock [ns], topic, type's name, message."""
    folder, connections = path.with_suffix(".folder"), dict[str, Any]()
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for wall, topic, name, message in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            writer.write(connections[topic], wall, store.serialize_cdr(message, name))
    shutil.move(str(next(folder.glob("*.mcap"))), path)
    shutil.rmtree(folder)
