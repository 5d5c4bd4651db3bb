"""ONNX files of affine functions, written without a library: policies for tests of their reading."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from valor.common.arrays import FloatArray

BIAS = ""  # key of an output's constant


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _field(number: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    data = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _message(*fields: tuple[int, int | str | bytes]) -> bytes:
    return b"".join(_field(*each) for each in fields)


def _tensor(name: str, values: FloatArray, external: str | None) -> bytes:
    dims = b"".join(_field(1, n) for n in values.shape)
    head = dims + _message((2, 1), (8, name))
    if external is not None:
        return head + _message((13, _message((1, "location"), (2, external))), (14, 1))
    return head + _field(9, values.astype("<f4").tobytes())


def _value(name: str, size: int) -> bytes:
    shape = b"".join(_field(1, _field(1, n)) for n in (1, size))
    return _message((1, name), (2, _field(1, _message((1, 1), (2, shape)))))


def _node(kind: str, inputs: Iterable[str], output: str) -> bytes:
    return b"".join(_field(1, each) for each in inputs) + _message((2, output), (4, kind))


def affine(
    file: Path,
    inputs: Mapping[str, int],
    outputs: Mapping[str, Mapping[str, FloatArray]],
    metadata: Mapping[str, str] | None = None,
    *,
    opset: int = 17,
    external: str | None = None,
) -> Path:
    """Write a model: each output is the sum of its constant (m,), and of its inputs times their matrices (k, m)."""
    graph = b""
    for output, terms in outputs.items():
        sums: list[str] = []
        for name, values in terms.items():
            weight = f"{output}/{name}"
            shaped = values.reshape(1, -1) if name == BIAS else values
            graph += _field(5, _tensor(weight, np.asarray(shaped), external))
            if name != BIAS:
                graph += _field(1, _node("MatMul", (name, weight), f"{weight}/product"))
            sums.append(weight if name == BIAS else f"{weight}/product")
        graph += _field(1, _node("Sum", sums, output))
        size = next(iter(terms.values())).shape[-1]
        graph += _field(12, _value(output, size))
    graph += _field(2, "affine") + b"".join(_field(11, _value(name, size)) for name, size in inputs.items())
    props = b"".join(_field(14, _message((1, key), (2, text))) for key, text in (metadata or {}).items())
    file.write_bytes(_message((1, 8), (7, graph), (8, _message((1, ""), (2, opset)))) + props)
    return file
