"""Decoding of messages by the definitions in the bag, or else by those of ROS 2 Jazzy."""

from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore

from valor.bags.errors import BagError
from valor.bags.stored import StoredTopic


class Types:
    """Decodes messages of the topics of one bag."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.EMPTY)
        self._jazzy = get_typestore(Stores.ROS2_JAZZY)
        self._known: dict[StoredTopic, Any] = {}

    def store(self, topic: StoredTopic) -> Any:
        """The type store with a topic's type. Raises ``BagError``: there is none; states why."""
        if topic not in self._known:
            self._known[topic] = self._find(topic)
        found = self._known[topic]
        if isinstance(found, str):
            raise BagError(f"{topic.name}: {found}")
        return found

    def decode(self, topic: StoredTopic, data: bytes) -> Any:
        """Decode a message. Raises ``BagError``: its type is unknown, or the data is not of that type."""
        store = self.store(topic)
        try:
            return store.deserialize_cdr(data, topic.type)
        except (SerdeError, ValueError, IndexError, UnicodeDecodeError, MemoryError) as error:
            text = " ".join(str(error).split()) or type(error).__name__
            raise BagError(f"{topic.name}: not {topic.type}: {text}") from None
        except Exception as error:  # struct.error and others that the generated code raises
            raise BagError(f"{topic.name}: not {topic.type}: {type(error).__name__}") from None

    def _find(self, topic: StoredTopic) -> Any:
        """A store, or the reason for its absence."""
        if topic.serialization != "cdr":
            return f"messages are encoded in {topic.serialization or 'an unknown format'}; expected cdr"
        reason = f"type {topic.type or 'unknown'} is not known"
        if topic.definition:
            try:
                read = get_types_from_idl if topic.encoding == "ros2idl" else get_types_from_msg
                found = read(topic.definition) if topic.encoding == "ros2idl" else read(topic.definition, topic.type)
                self._store.register({name: each for name, each in found.items() if name not in self._store.fielddefs})
                if topic.type in self._store.fielddefs:
                    return self._store
            except (TypesysError, KeyError, ValueError) as error:
                reason = f"the definition of {topic.type} is not readable: {' '.join(str(error).split())}"
        return self._jazzy if topic.type in self._jazzy.fielddefs else reason
