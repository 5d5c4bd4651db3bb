"""From where a film is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from valor.common.arrays import FloatArray

_CALM = 0.5  # a camera that follows does not follow what is shorter [s]


@dataclass(frozen=True)
class Camera:
    """Where it is, as seen from the robot at the film's beginning.

    Attributes:
        azimuth: where it looks, from the robot's heading, anticlockwise [degrees].
        elevation: likewise, up [degrees].
        distance: from the point that it looks at, in heights of the robot.
        height: of that point over the soles, in heights of the robot.
        follows: whether that point goes with the robot; else it stays in the middle of the whole way.
    """

    azimuth: float
    elevation: float
    distance: float = 1.5
    height: float = 0.5
    follows: bool = True


# fmt: off
CAMERAS = {
    "follow":   Camera(148.0, -10.0),
    "front":    Camera(180.0, -6.0),
    "back":     Camera(0.0, -12.0),
    "left":     Camera(-90.0, -6.0),
    "right":    Camera(90.0, -6.0),
    "above":    Camera(0.0, -89.0, 2.2),
    "feet":     Camera(125.0, -14.0, 0.75, 0.12),
    "hands":    Camera(140.0, -14.0, 1.05, 0.66),
    "shoulder": Camera(42.0, -14.0, 1.15, 0.62),
    "fixed":    Camera(125.0, -12.0, 1.75, 0.4, follows=False),
}
# fmt: on


@dataclass(frozen=True)
class View:
    """Where a camera is for one picture, in world."""

    point: FloatArray  # (3,) that it looks at [m]
    azimuth: float  # [degrees]
    elevation: float  # [degrees]
    distance: float  # [m]


def views(camera: Camera, places: FloatArray, heading: float, size: float, step: float) -> list[View]:
    """Of a whole film.

    Args:
        camera: which.
        places: (n, 3) of the robot's middle over the ground, at the soles' height [m].
        heading: of the robot at the beginning [rad].
        size: height of the robot [m].
        step: between the pictures [s].
    """
    way = 0.0
    if camera.follows:
        points = gaussian_filter1d(places, _CALM / step, axis=0, mode="nearest")
    else:
        low, high = places.min(axis=0), places.max(axis=0)
        points, way = np.broadcast_to((low + high) / 2.0, places.shape), float(np.linalg.norm((high - low)[:2]))
    up = np.array([0.0, 0.0, camera.height * size])
    azimuth = camera.azimuth + float(np.rad2deg(heading))
    return [View(point + up, azimuth, camera.elevation, camera.distance * size + 0.6 * way) for point in points]
