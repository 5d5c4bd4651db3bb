"""A message type's schema: by it two nodes know that they agree on the type."""

from __future__ import annotations

import hashlib
import json

import msgspec


class Schema(msgspec.Struct, frozen=True):
    """What a message type looks like.

    Attributes:
        name: of the class.
        types: class name to list of [field, type], of the class itself and of every message it contains. A type is
            ``int``, ``float``, ``bool``, ``str``, ``bytes``, ``float64[]``, ``uint8[]``, ``list<T>``, ``T?`` (or
            none), or a class name.
    """

    name: str
    types: dict[str, list[list[str]]]

    @property
    def has_arrays(self) -> bool:
        """Whether a field of it, or of a message that it contains, is an array, or a list of them."""
        return any("[]" in kind for fields in self.types.values() for _, kind in fields)

    def digest(self) -> bytes:
        """Eight bytes that differ when anything above does: BLAKE2b of the schema as canonical JSON."""
        content = [self.name, self.types]
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        return hashlib.blake2b(text.encode(), digest_size=8).digest()
