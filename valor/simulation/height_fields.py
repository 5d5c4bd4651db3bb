"""MuJoCo's height fields as triangles."""

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray


def triangles(model: mujoco.MjModel, field: int, fine: float = 0.0) -> tuple[FloatArray, npt.NDArray[Any]]:
    """Two triangles per cell of the grid, counterclockwise from above.

    Args:
        model: with the field.
        field: its number.
        fine: smallest spacing of the vertices; the grid's own if it is coarser [m].

    Returns:
        (v, 3) vertices in the frame of the field's geom [m], and (f, 3) faces.
    """
    rows, columns, first = (int(each[field]) for each in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr))
    half_x, half_y, high, _ = model.hfield_size[field]
    heights = model.hfield_data[first : first + rows * columns].reshape(rows, columns) * high
    coarse = max(1, int(fine / (2.0 * half_x / (columns - 1))))
    x = np.linspace(-half_x, half_x, columns)[::coarse]
    y = np.linspace(-half_y, half_y, rows)[::coarse]
    vertices = np.stack([*np.meshgrid(x, y), heights[::coarse, ::coarse]], axis=-1).reshape(-1, 3)
    corner = (np.arange(y.size - 1)[:, None] * x.size + np.arange(x.size - 1)).ravel()
    lower = np.column_stack((corner, corner + 1, corner + x.size + 1))
    upper = np.column_stack((corner, corner + x.size + 1, corner + x.size))
    return vertices, np.concatenate((lower, upper))
