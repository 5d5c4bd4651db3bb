"""What can be plotted: every number that was heard, by a name with its unit, and the numbers of any other message."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from numbers import Real
from typing import Any

from valor.operator_station.heard import Heard

MOST = 300  # numbers of one message that are offered
LONGEST = 64  # numbers of one of its arrays


def position(joint: str) -> str:
    """The signal of a joint's position."""
    return f"position {joint} [rad]"


def commanded(joint: str) -> str:
    """The signal of its set-point."""
    return f"commanded {joint} [rad]"


def signals(heard: Heard) -> dict[str, float]:
    """Everything that the page hears anyway, by name with its unit."""
    values = {position(name): angle for name, angle in heard.joints.items()}
    values |= {f"velocity {name} [rad/s]": speed for name, speed in heard.velocities.items()}
    values |= {f"effort {name} [N·m]": effort for name, effort in heard.efforts.items()}
    if len(heard.commanded) == len(heard.joints):
        for (name, angle), wanted in zip(heard.joints.items(), heard.commanded.tolist(), strict=True):
            values[commanded(name)] = wanted
            values[f"tracking error {name} [rad]"] = angle - wanted
    for name, point in heard.points.items():
        values |= {f"{name} {axis} [m]": float(value) for axis, value in zip("xyz", point, strict=True)}
    for name, wrench in heard.wrenches.items():
        values |= {f"{name} force {axis} [N]": float(value) for axis, value in zip("xyz", wrench[:3], strict=True)}
    for name, value in heard.numbers.items():
        time_of = name.endswith("_time")
        values[f"{name} [ms]" if time_of else name] = 1e3 * value if time_of else value
    values |= {f"{topic} on its way [ms]": 1e3 * seconds for topic, seconds in heard.transits.items()}
    x, y, z = heard.pelvis.position
    return values | {"pelvis x [m]": x, "pelvis y [m]": y, "pelvis z [m]": z}


def numbers_of(topic: str, message: Any) -> dict[str, float]:
    """The numbers of a ROS message, by topic and field: ``/imu/data angular_velocity.x``."""
    return {f"{topic} {path}": value for path, value in islice(_leaves(message, ""), MOST)}


def _leaves(value: Any, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, Real):  # NumPy's, too
        yield path, float(value)
    elif hasattr(value, "get_fields_and_field_types"):
        for name in value.get_fields_and_field_types():
            yield from _leaves(getattr(value, name), f"{path}.{name}" if path else name)
    elif hasattr(value, "__len__") and not isinstance(value, str | bytes):
        for place, item in enumerate(islice(value, LONGEST)):
            yield from _leaves(item, f"{path}[{place}]")
