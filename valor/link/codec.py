"""The state codec: a vector of the layout as some fifty to a hundred bytes, by itself or against an acknowledged frame.

A frame that stands by itself has every number as one of its levels, all alike. A predicted one has the differences to
a reference, a frame that the receiver is known to have; of each group the size of its differences is told first, which
sets their probabilities. So no frame needs any but the one that it names: what is lost is lost alone.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.link.entropy import SCALES, Symbol, Uniform, Unpacker, pack, residual, take_residual
from valor.link.errors import CodecError
from valor.link.fields import Layout
from valor.link.orientation import whole, without

KEPT = 512  # frames that may be referred to
DISTANCE = Uniform(KEPT)  # from a frame to its reference, in frames; 0: it stands by itself
FLAG = Uniform(2)
FIRST = "status"  # the group by which others are predicted

Levels = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Frame:
    """What arrives.

    Attributes:
        values: (N,) in the layout's order.
        clamped: (N,) where the truth lies beyond the range, or was no number.
        levels: (N,) the numbers as quantised.
    """

    values: FloatArray
    clamped: npt.NDArray[np.bool_]
    levels: Levels


class Codec:
    """Encodes and decodes frames of one layout; keeps nothing."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self._most = np.array(layout.levels) - 1
        self._uniform = [Uniform(count) for count in layout.levels]
        self._groups = [layout.groups[FIRST], *(each for name, each in layout.groups.items() if name != FIRST)]
        self._orientation, self._largest = layout.places["base_orientation"], layout.places["base_largest"].start

    def quantise(self, values: FloatArray) -> Frame:
        """What will arrive of values (N,), whatever they are."""
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
        """As bytes.

        Args:
            frame: by ``quantise``.
            reference: that the receiver has; None: it stands by itself.
            distance: of the reference, in frames, 1 to 511.
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
        """(N,) levels of the reference, its orientation told as the frame's is."""
        was = int(reference.levels[self._largest])
        if was == largest:
            return reference.levels
        quaternion = whole(reference.values[self._orientation], was)
        levels = reference.levels.copy()
        place = self._orientation
        told = (without(quaternion, largest)[0] - self.layout.low[place]) / self.layout.step[place]
        levels[place] = np.clip(np.rint(told), 0, self._most[place])
        return levels

    @staticmethod
    def distance(data: bytes) -> int:
        """How many frames before this one its reference was; 0: it stands by itself.

        Raises:
            CodecError: these are no bytes of a frame.
        """
        return Unpacker(data).take(DISTANCE)

    def decode(self, data: bytes, reference: Frame | None = None) -> Frame:
        """What ``encode`` was given.

        Args:
            data: of one frame.
            reference: that it names.

        Raises:
            CodecError: these are no bytes of a frame, or the reference is missing.
        """
        unpacker = Unpacker(data)
        if unpacker.take(DISTANCE) == 0:
            levels = np.array([unpacker.take(each) for each in self._uniform], dtype=np.int64)
        elif reference is None:
            raise CodecError("predicted from a frame that is not here")
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
                    raise CodecError(f"value {place} beyond its range")
                levels[place] = level
        return levels


def _group(differences: list[int]) -> list[Symbol]:
    total = sum(abs(each) for each in differences)
    if not total:
        return [(Uniform(SCALES), 0)]
    scale = min(max(round(math.log2(total / len(differences))) + 2, 1), SCALES - 1)
    return [(Uniform(SCALES), scale), *(symbol for each in differences for symbol in residual(each, scale))]


class Sender:
    """Encodes a stream of frames against the newest that is acknowledged, or by themselves, whichever is shorter."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._sent: OrderedDict[int, Frame] = OrderedDict()
        self._reference = -1

    def encode(self, values: FloatArray, number: int) -> bytes:
        """The bytes of frame ``number``, which grows from frame to frame."""
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
        """The receiver has this frame. It keeps it until a newer one is referred to."""
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
        """Frame ``number``.

        Raises:
            CodecError: as of ``Codec.decode``.
        """
        distance = self._codec.distance(data)
        frame = self._codec.decode(data, self._seen.get(number - distance) if distance else None)
        self._seen[number] = frame
        if len(self._seen) > KEPT:
            self._seen.popitem(last=False)
        return frame
