"""MuJoCo's renderer without a display: with EGL, or OSMesa if ``MUJOCO_GL`` is ``osmesa``, at any import order."""

import os
from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.drawing import OFFSCREEN, RenderingError
from valor.drawing.marks import Arrow, Ball, Mark, Polyline, rgb

Image = npt.NDArray[np.uint8]

_MAX_GEOMS = 4000
_INSTALL = f"no off-screen OpenGL here: install {' '.join(OFFSCREEN)} (Debian, Ubuntu)"


class Offscreen:
    """Draws images of one model in one size. Raises RenderingError: no OpenGL platform is available."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._model = model
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        self._image: Image = np.zeros((height, width, 3), dtype=np.uint8)
        self._depth = np.zeros((height, width), dtype=np.float32)
        self._platform = _platform(width, height)
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS)
        self._option = mujoco.MjvOption()

    def render(self, data: mujoco.MjData, camera: mujoco.MjvCamera, marks: Iterable[Mark] = ()) -> Image:
        """Return (height, width, 3) the image of the camera, with marks."""
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateCamera(self._model, data, camera, self._scene)  # the headlight uses the scene's last camera
        drawn = tuple(marks)
        self._option.flags[mujoco.mjtVisFlag.mjVIS_TRANSPARENT] = any(
            not isinstance(mark, Polyline)
            for mark in drawn  # inside the robot
        )
        mujoco.mjv_updateScene(self._model, data, self._option, None, camera, everything, self._scene)
        for mark in drawn:
            _add(self._scene, mark)
        mujoco.mjr_render(self._rectangle, self._scene, self._context)
        mujoco.mjr_readPixels(self._image, None, self._rectangle, self._context)
        return self._image[::-1]  # OpenGL's first row is the lowest

    def inverse_depth(self) -> npt.NDArray[np.float32]:
        """Return (height, width) 1 / depth of the last image's pixels, along the axis of the camera [1/m]."""
        mujoco.mjr_readPixels(None, self._depth, self._rectangle, self._context)
        clip, extent = self._model.vis.map, self._model.stat.extent
        near, far = 1.0 / (clip.znear * extent), 1.0 / (clip.zfar * extent)
        return np.float32(near - far) * self._depth[::-1] + np.float32(far)

    def close(self) -> None:
        """Free the graphics memory."""
        self._context.free()
        self._platform.free()


def _add(scene: mujoco.MjvScene, mark: Mark) -> None:
    if isinstance(mark, Ball):
        _geom(scene, mujoco.mjtGeom.mjGEOM_SPHERE, mark, np.full(3, mark.radius), mark.position)
        return
    shape = mujoco.mjtGeom.mjGEOM_ARROW if isinstance(mark, Arrow) else mujoco.mjtGeom.mjGEOM_CAPSULE
    points = (mark.start, mark.end) if isinstance(mark, Arrow) else mark.points
    closing = points[:1] if isinstance(mark, Polyline) and mark.closed else ()
    for start, end in pairwise([*points, *closing]):
        made = _geom(scene, shape, mark, np.zeros(3), np.zeros(3))
        if made is not None:
            mujoco.mjv_connector(made, shape, mark.width, np.asarray(start, float), np.asarray(end, float))


def _geom(
    scene: mujoco.MjvScene, shape: int, mark: Mark, size: FloatArray, position: FloatArray
) -> mujoco.MjvGeom | None:
    if scene.ngeom >= scene.maxgeom:
        return None
    made = scene.geoms[scene.ngeom]
    rgba = np.array([*(part / 255 for part in rgb(mark.color)), 1.0], dtype=np.float32)
    mujoco.mjv_initGeom(made, shape, size, np.asarray(position, float), np.eye(3).ravel(), rgba)
    made.emission = 0.35  # visible in the robot's shade
    scene.ngeom += 1
    return made


def _platform(width: int, height: int) -> Any:
    try:
        if os.environ.get("MUJOCO_GL", "").lower() == "osmesa":
            from mujoco.osmesa import GLContext
        else:
            from mujoco.egl import GLContext
        context = GLContext(width, height)
        context.make_current()
    except Exception as error:  # any error of the bindings if a library or a device is missing
        text = " ".join(str(error).split()) or type(error).__name__
        raise RenderingError(f"{_INSTALL}; {text}") from None
    return context
