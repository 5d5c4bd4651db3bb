"""A long height field in tiles, of which those alone are drawn that the camera is near: drawing all takes longest."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray

LENGTH = 2.0  # of a tile along x [m]
NEAR = 3.0  # of the point looked at, tiles are as fine as the field; farther ones have a sixteenth of its points [m]
BESIDE, AHEAD = 7.0, 16.0  # so far tiles are drawn, and where the camera looks towards [m]
COARSE = 4  # points of the field for one of a tile that is far
_HIDDEN = 5  # a group of geoms that MuJoCo does not draw unless told to
_BASE = 0.01  # what MuJoCo wants below the lowest point [m]


def split(spec: mujoco.MjSpec) -> None:
    """Put tiles in the place of every height field of a world, for pictures alone."""
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_HFIELD:
            field = next(each for each in spec.hfields if each.name == geom.hfieldname)
            _split(spec, geom, field)


def show(model: mujoco.MjModel, point: FloatArray, azimuth: float) -> None:
    """Of all tiles draw those around a point (3,) in world [m], seen in a direction [degrees]."""
    towards = np.cos(np.deg2rad(azimuth))
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD):
        off = float(model.geom_pos[geom, 0] - point[0])
        drawn = abs(off) < BESIDE or (abs(off) < AHEAD and off * towards > 0.0)
        coarse = model.geom(geom).name.endswith(_FAR)
        model.geom_group[geom] = 0 if drawn and coarse == (abs(off) > NEAR) else _HIDDEN


_FAR = "/far"


def _split(spec: mujoco.MjSpec, geom: mujoco.MjsGeom, field: mujoco.MjsHField) -> None:
    rows, columns = field.nrow, field.ncol
    half, across, rise, _ = field.size
    heights = np.array(field.userdata).reshape(rows, columns) * rise + geom.pos[2]
    x = geom.pos[0] + np.linspace(-half, half, columns)
    each = max(1, round(LENGTH / (x[1] - x[0])))
    for begin in range(0, columns - 1, each):
        end = min(begin + each, columns - 1)
        part, far = heights[:, begin : end + 1], (max(1, (rows - 1) // COARSE), max(1, (end - begin) // COARSE))
        chosen = [_spread(size, count + 1) for size, count in zip(part.shape, far, strict=True)]
        place, half_size = [(x[begin] + x[end]) / 2, geom.pos[1]], [(x[end] - x[begin]) / 2, across]
        for name, tile in ((f"{field.name}/{begin}", part), (f"{field.name}/{begin}{_FAR}", part[np.ix_(*chosen)])):
            low, extent = float(tile.min()), max(float(np.ptp(tile)), 1e-6)
            spec.add_hfield(
                name=name,
                nrow=tile.shape[0],
                ncol=tile.shape[1],
                size=[*half_size, extent, _BASE],
                userdata=((tile - low) / extent).ravel(),
            )
            spec.worldbody.add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_HFIELD,
                hfieldname=name,
                pos=[*place, low],
                material=geom.material,
                contype=0,
                conaffinity=0,
            )
    spec.delete(geom)
    spec.delete(field)


def _spread(size: int, count: int) -> npt.NDArray[np.intp]:
    """So many of ``size`` indices, the first and the last among them, evenly."""
    return np.linspace(0, size - 1, count).round().astype(np.intp)
