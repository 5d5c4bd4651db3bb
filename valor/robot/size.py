"""Size of a robot, and the scaling of defaults in its robot.yaml, which are ESCHER's.

A scaled field declares its dimension. The factors keep the Froude number v²/(g·l); with legs λ times as long times
scale by √λ. Forces scale by mass, margins at a sole's edge by the sole's width.
"""

from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, TypeVar

import msgspec.inspect
from msgspec import Meta

from valor.common.table import Table


class Size(Table):
    """Size of a robot, as far as defaults depend on it."""

    leg: Annotated[float, Meta(gt=0, le=3, extra={"unit": "m"})]  # length of the straight leg from hip to ankle [m]
    mass: Annotated[float, Meta(gt=0, le=1000, extra={"unit": "kg"})]  # [kg]


ESCHER = Size(leg=0.82, mass=75.9)
ESCHER_HALF_WIDTH = 0.07425  # of its soles [m]
NARROW = 0.5  # relative to ESCHER's sole, per leg length: narrower soles rock on uneven ground

N = TypeVar("N", bound=float)
Length = Annotated[N, Meta(extra={"dimension": "length", "unit": "m"})]
Sole = Annotated[N, Meta(extra={"dimension": "sole", "unit": "m"})]
"""Length that scales with the sole's width."""
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
    """Return dimension → factor of ESCHER's values, from the size and the narrower sole's half width [m]."""
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
    """Return 1 for soles at least as wide as ``NARROW`` for the leg length [m], less for narrower ones."""
    return min(1.0, half_width / leg / (NARROW * ESCHER_HALF_WIDTH / ESCHER.leg))


def completed(kind: type[Table], content: object, factor: Mapping[str, float]) -> Any:
    """Add the defaults, scaled by the factors, to the plain content of a table; invalid content stays as it is."""
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
    kinds = kind.types if isinstance(kind, msgspec.inspect.UnionType) else (kind,)
    return next((each for each in kinds if isinstance(each, msgspec.inspect.StructType)), None)
