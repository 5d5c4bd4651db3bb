"""Whole numbers into one number, and back: a range asymmetric numeral system on Python's unbounded integers.

J. Duda, "Asymmetric numeral systems" (2009), uniform and range variants. As the state is never cut into words, nothing
is lost but the bits that fill the last byte, and every non-negative integer is a sequence of symbols: no input is
malformed before the end, where the state must be the one that encoding began with.
"""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

from valor.link.errors import CodecError

BEGIN = 1
TOTAL_BITS = 14  # of the sum of a distribution's weights
LONGEST = 1024  # of what is decoded [B]


@dataclass(frozen=True)
class Uniform:
    """Values 0 … count − 1, all alike."""

    count: int

    def push(self, state: int, value: int) -> int:
        """The state with a value on top."""
        return state * self.count + value

    def pop(self, state: int) -> tuple[int, int]:
        """The state without the value on top, and the value."""
        return divmod(state, self.count)


class Weighted:
    """Values 0 … n − 1 with probabilities; none is impossible."""

    def __init__(self, weights: Iterable[float]) -> None:
        weights = list(weights)
        room = (1 << TOTAL_BITS) - len(weights)
        whole = sum(weights)
        frequencies = [1 + int(room * weight / whole) for weight in weights]
        frequencies[0] += (1 << TOTAL_BITS) - sum(frequencies)
        self._frequencies = frequencies
        self._starts = [0]
        for frequency in frequencies[:-1]:
            self._starts.append(self._starts[-1] + frequency)

    def push(self, state: int, value: int) -> int:
        """As ``Uniform.push``."""
        quotient, rest = divmod(state, self._frequencies[value])
        return (quotient << TOTAL_BITS) + self._starts[value] + rest

    def pop(self, state: int) -> tuple[int, int]:
        """As ``Uniform.pop``."""
        slot = state & ((1 << TOTAL_BITS) - 1)
        value = bisect_right(self._starts, slot) - 1
        return self._frequencies[value] * (state >> TOTAL_BITS) + slot - self._starts[value], value


Symbol = tuple[Uniform | Weighted, int]


def pack(symbols: Iterable[Symbol]) -> bytes:
    """Symbols as bytes; ``Unpacker`` gives them back in the same order."""
    state = BEGIN
    for distribution, value in reversed(list(symbols)):
        state = distribution.push(state, value)
    return state.to_bytes((state.bit_length() + 7) // 8, "big")


class Unpacker:
    """Takes symbols out of bytes."""

    def __init__(self, data: bytes) -> None:
        """Begin.

        Raises:
            CodecError: no packer makes such bytes.
        """
        if not data or len(data) > LONGEST or not data[0]:
            raise CodecError(f"{len(data)} bytes; expected 1 to {LONGEST}, the first not 0")
        self._state = int.from_bytes(data, "big")

    def take(self, distribution: Uniform | Weighted) -> int:
        """The next value."""
        self._state, value = distribution.pop(self._state)
        return value

    def finish(self) -> None:
        """Everything has been taken.

        Raises:
            CodecError: it has not, or there was less.
        """
        if self._state != BEGIN:
            raise CodecError("symbols do not end where they should")


SCALES = 16
"""Of residuals: scale s is for those of a mean size of about 2^(s − 2); scale 0 for those that are all 0."""
_BITS = 40  # of the largest residual


@cache
def bit_lengths(scale: int) -> Weighted:
    """Of the bit length of a residual, if sizes fall off geometrically, on average at ``scale``."""
    mean = 2.0 ** (scale - 2)
    ratio = mean / (1.0 + mean)
    edges = [0, *(1 << k for k in range(_BITS + 1))]  # a size of k bits is from 2^(k−1) to 2^k − 1
    return Weighted(ratio**low - ratio**high for low, high in itertools.pairwise(edges))


def residual(value: int, scale: int) -> list[Symbol]:
    """The symbols of a signed number; ``scale``: not 0."""
    bits = abs(value).bit_length()
    symbols: list[Symbol] = [(bit_lengths(scale), bits)]
    if bits:
        symbols.append((Uniform(1 << bits), (abs(value) - (1 << (bits - 1))) * 2 + (value < 0)))
    return symbols


def take_residual(unpacker: Unpacker, scale: int) -> int:
    """The inverse of ``residual``."""
    bits = unpacker.take(bit_lengths(scale))
    if not bits:
        return 0
    size, negative = divmod(unpacker.take(Uniform(1 << bits)), 2)
    size += 1 << (bits - 1)
    return -size if negative else size
