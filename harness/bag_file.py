"""A bag written by another writer than the recorder's."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
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


def add_metadata(path: Path, name: str, record: dict[str, str]) -> None:
    """Write a finished MCAP file anew, with a metadata record before its messages."""
    whole = path.with_suffix(".new")
    with open(path, "rb") as old, open(whole, "wb") as new:
        writer = McapWriter(new)
        writer.start(profile="ros2")
        writer.add_metadata(name, record)
        schemas, channels = dict[int, int](), dict[int, int]()
        for schema, channel, message in make_reader(old).iter_messages():
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
                )
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    whole.replace(path)
