"""Meshes for who looks from elsewhere: files that ``/robot_description`` names by ``file:``, and no others."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree

from rclpy.serialization import deserialize_message
from std_msgs.msg import String

TOPIC, TYPE = "robot_description", "std_msgs/msg/String"


class Assets:
    """What may be fetched: read by the loop from the description, asked for by the server's threads."""

    def __init__(self) -> None:
        self._named: frozenset[str] = frozenset()

    def learn(self, data: bytes) -> None:
        """Take the names of meshes from a description as it came; one that is no XML has none."""
        try:
            root = ElementTree.fromstring(deserialize_message(data, String).data)
        except ElementTree.ParseError:
            return
        self._named |= {mesh.attrib.get("filename", "") for mesh in root.iter("mesh")}

    def read(self, uri: str) -> bytes | None:
        """A mesh's file; None: nobody named it, or it cannot be read."""
        parts = urlsplit(uri)
        if uri not in self._named or parts.scheme != "file":
            return None
        try:
            return Path(unquote(parts.path)).read_bytes()
        except OSError:
            return None
