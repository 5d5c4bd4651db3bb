"""What the robot sees: its world and its own limbs, from the middle of its head."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.poses import Pose
from valor.common.rotation import Quaternion
from valor.drawing.offscreen import Image
from valor.drawing.posture import Posture
from valor.drawing.scene import Quality, Scene
from valor.robot.description import RobotDescription
from valor.robot.model import robot_spec

WIDTH, HEIGHT = 640, 480  # [pixels]
FIELD_OF_VIEW = math.radians(60.0)  # from top to bottom
DOWN = math.radians(25.0)  # where it looks, below the horizon, while the head is level
FOCAL_LENGTH = 0.5 * HEIGHT / math.tan(0.5 * FIELD_OF_VIEW)  # [pixels]
_FREE = 0.02  # before the foremost point of what carries it [m]
_NAME = "head_camera"
_QUALITY = Quality(larger=1.0, shadow=0, slices=12)


def body_of(robot: RobotDescription) -> str:
    """Of the robot's model, the one that carries the camera: the head, or without one the chest."""
    return robot.tables.head or robot.tables.chest


def pose_in_body(robot: RobotDescription) -> Pose:
    """Where the camera is in the body that carries it, in the optical frame of REP 103: z ahead, x right, y down.

    In front of the middle of the body with all that it carries; where all joints are at 0 it looks where the left sole
    points, and down by ``DOWN``.
    """
    model = robot_spec(robot, "all").compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    body = model.body(body_of(robot)).id
    shapes = [geom for geom in range(model.ngeom) if _carries(model, body, int(model.geom_bodyid[geom]))]
    toes = data.site(robot.tables.feet.left.sole).xmat.reshape(3, 3)[:, 0]
    yaw = math.atan2(toes[1], toes[0])
    level = np.array([[math.cos(yaw), math.sin(yaw), 0.0], [-math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    boxes = np.array([_box(model, data, geom, level) for geom in shapes] or [(level @ data.xpos[body],) * 2])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    place = level.T @ (high[0] + _FREE, *(low + high)[1:] / 2)
    ahead = level.T @ (math.cos(DOWN), 0.0, -math.sin(DOWN))
    right = -level[1]
    optical = np.column_stack([right, np.cross(ahead, right), ahead])
    rotation = data.xmat[body].reshape(3, 3)
    x, y, z = map(float, rotation.T @ (place - data.xpos[body]))
    return Pose((x, y, z), _quaternion(rotation.T @ optical))


class Eye:
    """Draws.

    Raises:
        RenderingError: there is no off-screen OpenGL here; names what to install.
    """

    def __init__(self, robot: RobotDescription, world: str, seed: int) -> None:
        place = pose_in_body(robot)

        def add(spec: mujoco.MjSpec) -> None:
            body = spec.body(body_of(robot))
            turned = np.array(place.rotation) @ np.diag([1.0, -1.0, -1.0])  # MuJoCo's looks along -z, with y up
            body.add_camera(name=_NAME, pos=place.position, quat=_quaternion(turned), fovy=math.degrees(FIELD_OF_VIEW))

        self._scene = Scene(robot, WIDTH, HEIGHT, world, seed, quality=_QUALITY, add=add)
        self._scene.look_through(_NAME)

    def see(self, posture: Posture) -> Image:
        """(height, width, 3) what it sees."""
        return self._scene.draw(posture)

    def close(self) -> None:
        """Give the graphics memory back."""
        self._scene.close()


def intrinsics() -> FloatArray:
    """(3, 3) of a pinhole, without distortion [pixels]."""
    return np.array([[FOCAL_LENGTH, 0.0, WIDTH / 2], [0.0, FOCAL_LENGTH, HEIGHT / 2], [0.0, 0.0, 1.0]])


def _quaternion(rotation: FloatArray) -> Quaternion:
    turned = np.empty(4)
    mujoco.mju_mat2Quat(turned, np.ascontiguousarray(rotation).ravel())
    w, x, y, z = map(float, turned)
    return (w, x, y, z)


def _carries(model: mujoco.MjModel, body: int, other: int) -> bool:
    """Whether it is the other, or the other is moved by it."""
    while other > body:
        other = int(model.body_parentid[other])
    return other == body


def _box(model: mujoco.MjModel, data: mujoco.MjData, geom: int, level: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) and (3,) lowest and highest coordinates [m] of what encloses a shape, where world is ``level``."""
    rotation = level @ data.geom_xmat[geom].reshape(3, 3)
    middle = level @ data.geom_xpos[geom] + rotation @ model.geom_aabb[geom, :3]
    half = np.abs(rotation) @ model.geom_aabb[geom, 3:]
    return middle - half, middle + half
