"""Off-screen pictures of the robot in its world."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow

from valor.common.arrays import FloatArray
from valor.drawing import Posture
from valor.drawing.marks import Mark
from valor.drawing.offscreen import Image, Offscreen
from valor.robot.description import RobotDescription
from valor.robot.model import Model, robot_spec
from valor.simulation import worlds

_EXTENT = 2.0  # Extent for haze, shadows and clipping, for any world [m]
_AHEAD = 1.5  # Distance of the point that a robot camera looks at [m]
_SUN = (2.5, -1.7, 3.5)  # Position of the sun relative to the ground below the point looked at [m]


@dataclass(frozen=True)
class Quality:
    """Rendering quality."""

    larger: float  # scale of the rendering before averaging, against jagged edges
    shadow: int  # size of the shadow map [pixels]
    slices: int  # of round shapes


STILL = Quality(larger=2.0, shadow=8192, slices=28)
MOVING = Quality(larger=1.3, shadow=1024, slices=16)
SMALL = Quality(larger=2.0, shadow=2048, slices=16)  # for small images


def scene_spec(
    robot: RobotDescription, size: tuple[int, int], world: str, seed: int, quality: Quality = STILL
) -> mujoco.MjSpec:
    """Return the robot and its world with plain sky, one sun with shadows and a fill light."""
    spec = robot_spec(robot, "all")
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.quality.shadowsize = quality.shadow
    spec.visual.quality.numslices, spec.visual.quality.numstacks = quality.slices, max(8, quality.slices // 2)
    spec.visual.quality.offsamples = 0  # drawn larger instead
    spec.visual.map.shadowclip = 1.6
    spec.visual.headlight.ambient[:] = 0.32
    spec.visual.headlight.diffuse[:] = 0.22
    spec.visual.headlight.specular[:] = 0.05
    spec.visual.rgba.haze[:] = (0.93, 0.94, 0.96, 1.0)
    spec.visual.map.haze = 0.4
    spec.visual.map.alpha = 0.45
    spec.add_texture(
        name="studio_sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.80, 0.85, 0.91],
        rgb2=[0.95, 0.96, 0.97],
        width=256,
        height=1536,
    )
    spec.stat.extent = _EXTENT
    ground = worlds.load(world, seed, worlds.size_of(robot))
    spec.attach(ground, frame=spec.worldbody.add_frame(), prefix=worlds.PREFIX)
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=_SUN,
        dir=[-0.75, 0.5, -1.0],
        diffuse=[0.75, 0.74, 0.72],
        specular=[0.3, 0.3, 0.3],
        castshadow=True,
    )
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[-2.0, 3.0, 3.0],
        dir=[0.5, -0.7, -0.6],
        diffuse=[0.18, 0.19, 0.22],
        specular=[0.0, 0.0, 0.0],
        castshadow=False,
    )
    return spec


class Scene:
    """Draws one robot in its world, posture by posture; ``add`` extends the scene before compilation.

    Raises RenderingError (no off-screen OpenGL) or ConfigurationError (the world does not exist).
    """

    def __init__(
        self,
        robot: RobotDescription,
        width: int,
        height: int,
        world: str = "flat",
        seed: int = 0,
        *,
        quality: Quality = STILL,
        add: Callable[[mujoco.MjSpec], None] | None = None,
    ) -> None:
        self._size = (width, height)
        large = (round(width * quality.larger), round(height * quality.larger))
        spec = scene_spec(robot, large, world, seed, quality)
        if add is not None:
            add(spec)
        self._model = Model(robot, spec.compile())
        self._data = mujoco.MjData(self._model.mj)
        self._fixtures = worlds.joints(self._model.mj)
        self._offscreen = Offscreen(self._model.mj, *large)
        self._camera = mujoco.MjvCamera()
        self._sun = self._model.mj.light("sun").id

    def close(self) -> None:
        """Free the graphics memory."""
        self._offscreen.close()

    def look_at(
        self, point: FloatArray, azimuth: float = 148.0, elevation: float = -8.0, distance: float = 2.62
    ) -> None:
        """Turn the camera to a point (3,) in world [m], from a direction [degrees] and a distance [m]."""
        self._camera.lookat[:] = point
        self._camera.azimuth, self._camera.elevation, self._camera.distance = azimuth, elevation, distance
        self._light(point)

    def look_through(self, camera: str) -> None:
        """Draw from a camera of the model."""
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = self._model.mj.camera(camera).id

    def draw(self, posture: Posture, marks: Iterable[Mark] = ()) -> Image:
        """Return (height, width, 3) the image of a posture with marks."""
        data, model = self._data, self._model
        data.qpos[:3] = posture.pelvis_position
        data.qpos[3:7] = posture.pelvis_orientation
        data.qpos[model.qpos] = posture.joint_position[model.joint_indices]
        if posture.fixture_position.size == self._fixtures.size:
            data.qpos[self._fixtures] = posture.fixture_position
        mujoco.mj_kinematics(model.mj, data)
        mujoco.mj_comPos(model.mj, data)
        mujoco.mj_camlight(model.mj, data)
        if self._camera.type == mujoco.mjtCamera.mjCAMERA_FIXED:
            ahead = -data.cam_xmat[self._camera.fixedcamid].reshape(3, 3)[:, 2]
            point = data.cam_xpos[self._camera.fixedcamid] + _AHEAD * ahead
            self._light(point)
            mujoco.mj_camlight(model.mj, data)
        image = self._offscreen.render(data, self._camera, marks)
        if image.shape[:2] == self._size[::-1]:
            return image  # until the next
        return np.asarray(Pillow.fromarray(image).resize(self._size, Pillow.Resampling.BOX))

    def inverse_depth(self) -> npt.NDArray[np.float32]:
        """Return 1 / depth of the last image's pixels as drawn, before averaging [1/m]."""
        return self._offscreen.inverse_depth()

    def _light(self, point: FloatArray) -> None:
        """Move the sun to (3,) a point in world [m]."""
        # MuJoCo draws shadows only near the lamp.
        self._model.mj.light_pos[self._sun] = (*(point[:2] + _SUN[:2]), _SUN[2])
