"""How large a robot is, and what it gets for what its robot.yaml does not say.

Defaults are ESCHER's. A field whose default depends on the robot's size says its dimension; a robot of another size
gets ESCHER's value times the dimension's factor. With legs λ times as long it falls as ESCHER does, √λ times as slowly:
the factors are those that keep Froude's number v²/(g·l). Forces go by the mass, margins at a sole's edge by the sole.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, TypeVar

import msgspec.inspect
from msgspec import Meta

from valor.common.table import Table


class Size(Table):
    """Of a robot, as far as defaults depend on it."""

    leg: Annotated[float, Meta(gt=0, le=3, extra={"unit": "m"})]  # straight, from hip to ankle [m]
    mass: Annotated[float, Meta(gt=0, le=1000, extra={"unit": "kg"})]  # [kg]


ESCHER = Size(leg=0.82, mass=75.9)
ESCHER_HALF_WIDTH = 0.07425  # of its soles [m]
NARROW = 0.5  # of a sole as wide as ESCHER's, by the leg: a narrower one rocks on uneven ground more than it holds

N = TypeVar("N", bound=float)
Length = Annotated[N, Meta(extra={"dimension": "length", "unit": "m"})]
Sole = Annotated[N, Meta(extra={"dimension": "sole", "unit": "m"})]
"""A length that goes by the sole's width."""
Time = Annotated[N, Meta(extra={"dimension": "time", "unit": "s"})]
Speed = Annotated[N, Meta(extra={"dimension": "speed", "unit": "m/s"})]
Rate = Annotated[N, Meta(extra={"dimension": "rate"})]
"""[1/s, rad/s]"""
SquaredRate = Annotated[N, Meta(extra={"dimension": "squared_rate"})]
"""[1/s², rad/s²]"""
PerArea = Annotated[N, Meta(extra={"dimension": "per_area"})]
"""[1/m²]"""
Force = Annotated[N, Meta(extra={"dimension": "force", "unit": "N"})]


def factors(size: Size, half_width: float) -> dict[str, float]:
    """Dimension → what ESCHER's values are multiplied by; all of them 1 for ESCHER.

    Args:
        size: of the robot.
        half_width: of its narrower sole [m].
    """
    length = size.leg / ESCHER.leg
    time = float(length**0.5)
    return {
        "length": length,
        "sole": half_width / ESCHER_HALF_WIDTH,
        "time": time,
        "speed": time,
        "rate": 1 / time,
        "squared_rate": 1 / length,
        "per_area": 1 / length**2,
        "force": size.mass / ESCHER.mass,
    }


def narrowness(leg: float, half_width: float) -> float:
    """1 of soles as wide for the robot's legs as ``NARROW`` says, or wider; less of narrower ones.

    Args:
        leg: as of ``Size`` [m].
        half_width: of its narrower sole [m].
    """
    return min(1.0, half_width / leg / (NARROW * ESCHER_HALF_WIDTH / ESCHER.leg))


def completed(kind: type[Table], content: object, factor: Mapping[str, float]) -> Any:
    """What ``checked`` makes a table of, with the defaults of a size; what it would not take stays as it is.

    Args:
        kind: of the table.
        content: plain values.
        factor: by dimension.
    """
    return _completed(_type(kind), content, factor)


@cache
def _type(kind: type[Table]) -> msgspec.inspect.StructType:
    found = msgspec.inspect.type_info(kind)
    assert isinstance(found, msgspec.inspect.StructType)
    return found


def _completed(kind: msgspec.inspect.StructType, content: object, factor: Mapping[str, float]) -> Any:
    if not isinstance(content, dict):
        return content
    more = {}
    for field in kind.fields:
        name, required = field.encode_name, field.required
        if isinstance(field.type, msgspec.inspect.Metadata):
            dimension = (field.type.extra or {}).get("dimension")
            if dimension and not required and name not in content:
                more[name] = field.default * factor[dimension]
        elif (inner := _table(field.type)) and (name in content or not (required or field.default is None)):
            more[name] = _completed(inner, content.get(name, {}), factor)
    return content | more


def _table(kind: msgspec.inspect.Type) -> msgspec.inspect.StructType | None:
    """The one that may stand there."""
    kinds = kind.types if isinstance(kind, msgspec.inspect.UnionType) else (kind,)
    return next((each for each in kinds if isinstance(each, msgspec.inspect.StructType)), None)
