"""Trajectories as motion planners send them: a smooth path, as fast as limits and scaling allow, at equal times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from valor.common.arrays import FloatArray


@dataclass(frozen=True)
class Planned:
    """m points of n joints.

    Attributes:
        time: (m,) from the start [s].
        position, velocity, acceleration: (m, n) [rad, rad/s, rad/s²].
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


def planned(path: FloatArray, velocity: FloatArray, acceleration: FloatArray, points: int) -> Planned:
    """Time a path as MoveIt's time-optimal parameterization does: accelerate, cruise, brake; rest at both ends.

    Args:
        path: (k, n) positions to go through, k at least 2 [rad].
        velocity, acceleration: (n,) limits that are kept [rad/s, rad/s²].
        points: m.
    """
    spline = CubicSpline(np.linspace(0.0, 1.0, len(path)), path, bc_type="natural")
    fine = np.linspace(0.0, 1.0, 2000)
    slope, bend = np.abs(spline(fine, 1)), np.abs(spline(fine, 2))
    with np.errstate(divide="ignore"):
        speed = min((velocity / slope.max(axis=0)).min(), np.sqrt(0.5 * acceleration / bend.max(axis=0)).min())
        push = (0.5 * acceleration / slope.max(axis=0)).min()
    ramp = min(speed / push, np.sqrt(1.0 / push))
    cruise = push * ramp
    duration = ramp + 1.0 / cruise
    time = np.linspace(0.0, duration, points)
    up, down = time < ramp, time > duration - ramp
    left = duration - time
    place = np.select([up, down], [0.5 * push * time**2, 1.0 - 0.5 * push * left**2], cruise * (time - 0.5 * ramp))
    rate = np.select([up, down], [push * time, push * left], cruise)[:, None]
    gain = np.select([up, down], [push, -push], 0.0)[:, None]
    first, second = spline(place, 1), spline(place, 2)
    return Planned(time, spline(place), first * rate, first * gain + second * rate**2)
