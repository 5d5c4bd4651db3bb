"""Multisense S7 by MuJoCo's renderer: the left image, and the depth that the disparity of its stereo pair gives."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.poses import Pose
from valor.drawing import Posture
from valor.drawing.offscreen import Image
from valor.drawing.scene import Quality, Scene
from valor.robot.description import RobotDescription
from valor.robot.tables import Camera

# Data sheet: half resolution, 15 Hz, 80° wide, 128 disparities in sixteenths of a pixel.
WIDTH, HEIGHT = 1024, 544  # [pixels]
RATE = 15.0  # [Hz]
FOCAL_LENGTH = 0.5 * WIDTH / math.tan(math.radians(40.0))  # [pixels]
BASELINE = 0.07  # between left and right camera [m]
STEPS = 16  # of a pixel of disparity
LEAST, MOST = STEPS, 128 * STEPS  # disparity that is found [steps]
FARTHEST = 15.0  # of points in a cloud, ``pointcloud_max_range`` of the maker's driver [m]
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<f4")])

_NAME = "multisense"
_DETAIL = Quality(larger=1.0, shadow=0, slices=12)
_DISPARITY_OF_INVERSE = np.float32(STEPS * FOCAL_LENGTH * BASELINE)  # [steps·m]
_DEPTH = np.full(MOST + 1, np.nan, np.float32)  # by disparity [m]
_DEPTH[LEAST:] = _DISPARITY_OF_INVERSE / np.arange(LEAST, MOST + 1)
_MILLIMETRES = np.rint(1000.0 * np.nan_to_num(_DEPTH)).astype(np.uint16)
_RIGHT, _DOWN = (
    each.astype(np.float32).ravel() / np.float32(FOCAL_LENGTH)
    for each in np.meshgrid(np.arange(WIDTH) - (WIDTH - 1) / 2, np.arange(HEIGHT) - (HEIGHT - 1) / 2)
)


@dataclass(frozen=True)
class Picture:
    """Image and disparity of one rendering, in the renderer's memory until the next one.

    Attributes:
        image: (HEIGHT, WIDTH, 3) red, green, blue.
        disparity: (HEIGHT, WIDTH) [steps]; 0 if it is not found.
    """

    image: Image
    disparity: npt.NDArray[np.int32]

    def bgr(self) -> Image:
        """Return (HEIGHT, WIDTH, 3) blue, green, red."""
        return self.image[:, :, ::-1]

    def depth(self) -> npt.NDArray[np.float32]:
        """Return (HEIGHT, WIDTH) depth along the camera's axis [m]; NaN if it is not found."""
        return _DEPTH[self.disparity]

    def millimetres(self) -> npt.NDArray[np.uint16]:
        """Return (HEIGHT, WIDTH) depth along the camera's axis [mm]; 0 if it is not found."""
        found: npt.NDArray[np.uint16] = _MILLIMETRES[self.disparity]
        return found

    def points(self) -> npt.NDArray[np.void]:
        """Return (k,) ``POINT`` of the pixels with a depth up to ``FARTHEST``, in the optical frame [m]."""
        depth = self.depth().ravel()
        pixels = np.flatnonzero(depth <= FARTHEST)
        depth = depth[pixels]
        colors = np.zeros((pixels.size, 4), np.uint8)  # 0xrrggbb, little endian
        colors[:, :3] = self.image.reshape(-1, 3)[pixels][:, ::-1]
        made = np.empty(pixels.size, POINT)
        made["x"], made["y"], made["z"] = _RIGHT[pixels] * depth, _DOWN[pixels] * depth, depth
        made["rgb"] = colors.view("<f4").ravel()
        return made


class Multisense:
    """The sensor in a world.

    Raises ConfigurationError (the robot has no camera, or the world does not exist) or RenderingError (there is no
    off-screen OpenGL).
    """

    def __init__(self, robot: RobotDescription, world: str, seed: int) -> None:
        if robot.tables.camera is None:
            raise ConfigurationError(f"{robot.name}: no camera in robot.yaml")
        self.body = robot.tables.camera.body
        self.pose = pose_in_body(robot.tables.camera)
        self._scene = Scene(robot, WIDTH, HEIGHT, world, seed, quality=_DETAIL, add=self._add)
        self._scene.look_through(_NAME)

    def _add(self, spec: mujoco.MjSpec) -> None:
        turned = np.array(self.pose.rotation) @ np.diag([1.0, -1.0, -1.0])  # MuJoCo's camera looks along -z, y is up
        fovy = math.degrees(2.0 * math.atan(0.5 * HEIGHT / FOCAL_LENGTH))
        spec.body(self.body).add_camera(name=_NAME, pos=self.pose.position, quat=_quaternion(turned), fovy=fovy)

    def look(self, posture: Posture) -> Picture:
        """Return what is seen; color and depth from one rendering."""
        image = self._scene.draw(posture)
        return Picture(image, matched(self._scene.inverse_depth()))

    def close(self) -> None:
        """Free the graphics memory."""
        self._scene.close()


def matched(inverse_depth: npt.NDArray[np.float32]) -> npt.NDArray[np.int32]:
    """Return disparities [steps] of 1 / depth [1/m]; 0 if it is too near."""
    steps = (_DISPARITY_OF_INVERSE * inverse_depth + np.float32(0.5)).astype(np.int32)
    steps[steps > MOST] = 0
    return steps


def pose_in_body(camera: Camera) -> Pose:
    """Return the pose of the left camera's optical frame (REP 103: z ahead, x right, y down) in its body."""
    ahead = np.array([math.cos(camera.pitch), 0.0, -math.sin(camera.pitch)])
    right = np.array([0.0, -1.0, 0.0])
    return Pose(camera.position, _quaternion(np.column_stack([right, np.cross(ahead, right), ahead])))


def intrinsics() -> FloatArray:
    """Return (3, 3) of a pinhole without distortion [pixels]; whole numbers are the middles of pixels."""
    f = FOCAL_LENGTH
    return np.array([[f, 0.0, (WIDTH - 1) / 2], [0.0, f, (HEIGHT - 1) / 2], [0.0, 0.0, 1.0]])


def _quaternion(rotation: FloatArray) -> tuple[float, float, float, float]:
    turned = np.empty(4)
    mujoco.mju_mat2Quat(turned, np.ascontiguousarray(rotation).ravel())
    w, x, y, z = map(float, turned)
    return (w, x, y, z)
