"""State codec: 30 to 100 bytes per frame, absolute or predicted from an acknowledged frame.

An absolute frame encodes each value with equal probabilities of its levels. A predicted frame encodes the differences
to a reference that the receiver has acknowledged; the scale of each group's differences, encoded first, sets their
probabilities. A frame depends only on its reference, so that a lost frame affects no other.

The entropy coder is a range asymmetric numeral system (J. Duda, 2009, uniform and range variants) on one unbounded
integer: only the padding of the last byte is overhead. Every non-negative integer decodes to symbols; after the last
symbol the state must be the initial one, else the input is malformed.
"""

import itertools
import math
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.link.errors import CodecError
from valor.link.fields import Layout, from_smallest_three, without

BEGIN = 1
TOTAL_BITS = 14  # log2 of the sum of a distribution's frequencies
LONGEST = 1024  # input [B]


@dataclass(frozen=True)
class Uniform:
    """Values 0 … count − 1 with equal probabilities."""

    count: int

    def push(self, state: int, value: int) -> int:
        """Push a value onto the state."""
        return state * self.count + value

    def pop(self, state: int) -> tuple[int, int]:
        """Pop a value: the remaining state, and the value."""
        return divmod(state, self.count)


class Weighted:
    """Values 0 … n − 1 with given weights; every probability is positive."""

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
        """Like ``Uniform.push``."""
        quotient, rest = divmod(state, self._frequencies[value])
        return (quotient << TOTAL_BITS) + self._starts[value] + rest

    def pop(self, state: int) -> tuple[int, int]:
        """Like ``Uniform.pop``."""
        slot = state & ((1 << TOTAL_BITS) - 1)
        value = bisect_right(self._starts, slot) - 1
        return self._frequencies[value] * (state >> TOTAL_BITS) + slot - self._starts[value], value


Symbol = tuple[Uniform | Weighted, int]


def pack(symbols: Iterable[Symbol]) -> bytes:
    """Encode symbols; ``Unpacker`` returns them in the same order."""
    state = BEGIN
    for distribution, value in reversed(list(symbols)):
        state = distribution.push(state, value)
    return state.to_bytes((state.bit_length() + 7) // 8, "big")


class Unpacker:
    """Decodes symbols."""

    def __init__(self, data: bytes) -> None:
        """Start. Raises CodecError: malformed."""
        if not data or len(data) > LONGEST or not data[0]:
            raise CodecError(f"{len(data)} bytes; expected 1 to {LONGEST}, the first not 0")
        self._state = int.from_bytes(data, "big")

    def take(self, distribution: Uniform | Weighted) -> int:
        """Next value."""
        self._state, value = distribution.pop(self._state)
        return value

    def finish(self) -> None:
        """Check that all symbols have been taken. Raises CodecError: more or fewer symbols than taken."""
        if self._state != BEGIN:
            raise CodecError("more or fewer symbols than expected")


SCALES = 16
"""Number of scales of residuals: scale s has a mean size of about 2^(s − 2); at scale 0 all residuals are 0."""
_BITS = 40  # longest residual


@cache
def bit_lengths(scale: int) -> Weighted:
    """Distribution of the bit length of a residual, for geometrically distributed sizes with the mean of ``scale``."""
    mean = 2.0 ** (scale - 2)
    ratio = mean / (1.0 + mean)
    edges = [0, *(1 << k for k in range(_BITS + 1))]  # a size of k bits is from 2^(k−1) to 2^k − 1
    return Weighted(ratio**low - ratio**high for low, high in itertools.pairwise(edges))


def residual(value: int, scale: int) -> list[Symbol]:
    """Symbols of a signed number; ``scale``: not 0."""
    bits = abs(value).bit_length()
    symbols: list[Symbol] = [(bit_lengths(scale), bits)]
    if bits:
        symbols.append((Uniform(1 << bits), (abs(value) - (1 << (bits - 1))) * 2 + (value < 0)))
    return symbols


def take_residual(unpacker: Unpacker, scale: int) -> int:
    """Inverse of ``residual``."""
    bits = unpacker.take(bit_lengths(scale))
    if not bits:
        return 0
    size, negative = divmod(unpacker.take(Uniform(1 << bits)), 2)
    size += 1 << (bits - 1)
    return -size if negative else size


KEPT = 512  # frames that may be references
DISTANCE = Uniform(KEPT)  # to the reference, in frames; 0: absolute
FLAG = Uniform(2)
FIRST = "status"  # group on which the prediction of others depends

Levels = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Frame:
    """Quantised state."""

    values: FloatArray  # (N,) in the layout's order
    clamped: npt.NDArray[np.bool_]  # (N,) whether the value was outside its range, or not finite
    levels: Levels  # (N,) quantised values


class Codec:
    """Encodes and decodes frames of one layout; stateless."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self._most = np.array(layout.levels) - 1
        self._uniform = [Uniform(count) for count in layout.levels]
        self._groups = [layout.groups[FIRST], *(each for name, each in layout.groups.items() if name != FIRST)]
        self._orientation, self._largest = layout.slices["base_orientation"], layout.slices["base_largest"].start

    def quantise(self, values: FloatArray) -> Frame:
        """Frame of any values (N,)."""
        layout = self.layout
        finite = np.where(np.isfinite(values), values, np.where(values > 0, layout.high, layout.low))
        inside = np.clip(finite, layout.low, layout.high)
        levels = np.rint((inside - layout.low) / layout.step).astype(np.int64)
        clamped = (np.abs(finite - inside) > layout.step / 2) | ~np.isfinite(values)
        return Frame(self._values(levels), clamped, levels)

    def _values(self, levels: Levels) -> FloatArray:
        values: FloatArray = self.layout.low + levels * self.layout.step
        return values

    def encode(self, frame: Frame, reference: Frame | None = None, distance: int = 0) -> bytes:
        """Encode a frame of ``quantise``, relative to a reference that the receiver has; None: absolute.

        ``distance``: of the reference, in frames, 1 to 511.
        """
        symbols: list[Symbol] = [(DISTANCE, distance if reference else 0)]
        if reference is None:
            symbols += zip(self._uniform, frame.levels.tolist(), strict=True)
        else:
            differences = (frame.levels - self._predicted(reference, int(frame.levels[self._largest]))).tolist()
            for group in self._groups:
                symbols += _group([differences[place] for place in group])
        anything = bool(frame.clamped.any())
        symbols.append((FLAG, int(anything)))
        if anything:
            symbols += ((FLAG, int(each)) for each in frame.clamped)
        return pack(symbols)

    def _predicted(self, reference: Frame, largest: int) -> Levels:
        """(N,) levels of the reference, with the frame's choice of quaternion components."""
        was = int(reference.levels[self._largest])
        if was == largest:
            return reference.levels
        quaternion = from_smallest_three(reference.values[self._orientation], was)
        levels = reference.levels.copy()
        place = self._orientation
        told = (without(quaternion, largest)[0] - self.layout.low[place]) / self.layout.step[place]
        levels[place] = np.clip(np.rint(told), 0, self._most[place])
        return levels

    @staticmethod
    def distance(data: bytes) -> int:
        """Distance of the reference, in frames; 0: absolute. Raises CodecError: malformed."""
        return Unpacker(data).take(DISTANCE)

    def decode(self, data: bytes, reference: Frame | None = None) -> Frame:
        """Inverse of ``encode``; ``reference``: at ``distance``. Raises CodecError: malformed, or it is missing."""
        unpacker = Unpacker(data)
        if unpacker.take(DISTANCE) == 0:
            levels = np.array([unpacker.take(each) for each in self._uniform], dtype=np.int64)
        elif reference is None:
            raise CodecError("reference frame missing")
        else:
            levels = self._differences(unpacker, reference)
        clamped = np.zeros(self.layout.size, dtype=bool)
        if unpacker.take(FLAG):
            clamped[:] = [unpacker.take(FLAG) for _ in range(self.layout.size)]
        unpacker.finish()
        return Frame(self._values(levels), clamped, levels)

    def _differences(self, unpacker: Unpacker, reference: Frame) -> Levels:
        predicted, levels = reference.levels, reference.levels.copy()
        for number, group in enumerate(self._groups):
            if number == 1:
                predicted = self._predicted(reference, int(levels[self._largest]))
            scale = unpacker.take(Uniform(SCALES))
            for place in group:
                level = int(predicted[place]) + (take_residual(unpacker, scale) if scale else 0)
                if not 0 <= level <= self._most[place]:
                    raise CodecError(f"value {place} outside its range")
                levels[place] = level
        return levels


def _group(differences: list[int]) -> list[Symbol]:
    total = sum(abs(each) for each in differences)
    if not total:
        return [(Uniform(SCALES), 0)]
    scale = min(max(round(math.log2(total / len(differences))) + 2, 1), SCALES - 1)
    return [(Uniform(SCALES), scale), *(symbol for each in differences for symbol in residual(each, scale))]


class Sender:
    """Encodes a stream of frames, predicted from the latest acknowledged one or absolute, whichever is shorter."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._sent: OrderedDict[int, Frame] = OrderedDict()
        self._reference = -1

    def encode(self, values: FloatArray, number: int) -> bytes:
        """Encode frame ``number``, which increases from frame to frame."""
        frame = self._codec.quantise(values)
        data = self._codec.encode(frame)
        reference, distance = self._sent.get(self._reference), number - self._reference
        if reference is not None and distance < DISTANCE.count:
            data = min(data, self._codec.encode(frame, reference, distance), key=len)
        self._sent[number] = frame
        if len(self._sent) > KEPT:
            self._sent.popitem(last=False)
        return data

    def acknowledged(self, number: int) -> None:
        """Use this frame, which the receiver has, as the reference."""
        if number in self._sent and number > self._reference:
            self._reference = number
            while next(iter(self._sent)) < number:
                self._sent.popitem(last=False)


class Receiver:
    """Decodes a stream of frames."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._seen: OrderedDict[int, Frame] = OrderedDict()

    def decode(self, data: bytes, number: int) -> Frame:
        """Decode frame ``number``. Raises CodecError: like ``Codec.decode``."""
        distance = self._codec.distance(data)
        frame = self._codec.decode(data, self._seen.get(number - distance) if distance else None)
        self._seen[number] = frame
        if len(self._seen) > KEPT:
            self._seen.popitem(last=False)
        return frame
