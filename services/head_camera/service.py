"""Publishes pictures of the simulated robot while a ROS 2 node subscribes."""

import io
import math
import time

import mujoco
import numpy as np
from PIL import Image as Pillow
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage
from std_msgs.msg import Header

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.messages import GroundTruth
from valor.common.poses import Pose
from valor.common.processes import CAMERA
from valor.common.rotation import Quaternion
from valor.common.topics import GROUND_TRUTH
from valor.drawing import Posture, RenderingError
from valor.drawing.scene import Quality, Scene
from valor.robot.description import RobotDescription
from valor.robot.model import robot_spec
from valor.ros.node import RosSide
from valor.ros.parameters import Parameters, Range
from valor.ros.transforms import publish_mount
from valor.service import Context, quiet_collector

FRAME = "head_camera_optical_frame"
RATE = 2.0  # Default rate of pictures by the wall clock [Hz]
QUALITY = 80  # JPEG quality
PERIOD = 0.1  # Polling period of subscriptions [s]
WIDTH, HEIGHT = 640, 480  # [pixels]
FIELD_OF_VIEW = math.radians(60.0)  # vertical
DOWN = math.radians(25.0)  # viewing angle below the horizon with a level head
FOCAL_LENGTH = 0.5 * HEIGHT / math.tan(0.5 * FIELD_OF_VIEW)  # [pixels]
_FREE = 0.02  # Distance in front of the carrying body [m]
_NAME = "head_camera"
_DETAIL = Quality(larger=1.0, shadow=0, slices=12)


class HeadCamera:
    """``camera/image_raw/compressed`` and ``camera/camera_info``; its frame in ``/tf_static``.

    Raises ConfigurationError: off-screen OpenGL is not available.
    """

    def __init__(self, context: Context) -> None:
        self._context, settings, robot = context, context.settings, context.robot
        self._truth = GROUND_TRUTH.subscriber(context.node)
        try:
            self._view = view(robot, settings.world, settings.seed)
        except RenderingError as error:
            raise ConfigurationError(f"{CAMERA}: {error}") from None
        self._side = RosSide(context.name, settings, context.instance.environment(), context.arguments)
        node, prefix = self._side.node, settings.frame_prefix
        rates = Range(0.1, 10.0)
        self._period = 1.0 / Parameters(node).declare("update_rate", RATE, "of pictures, at most [Hz]", rates)
        self._frame = prefix + FRAME
        self._images = node.create_publisher(CompressedImage, "camera/image_raw/compressed", qos_profile_sensor_data)
        self._infos = node.create_publisher(CameraInfo, "camera/camera_info", qos_profile_sensor_data)
        publish_mount(node, prefix + body_of(robot), self._frame, pose_in_body(robot))
        self._side.life.configure()

    def run(self) -> None:
        """Draw until stopped."""
        quiet_collector()
        statistics, stopping = self._context.statistics, self._context.stopping
        self._side.life.set_ready(True)
        drawn, due = -1, 0.0
        while not stopping.wait(PERIOD):
            self._side.serve_pending()
            newest = self._truth.latest()
            listeners = self._images.get_subscription_count() + self._infos.get_subscription_count()
            statistics.state("ready", f"{listeners} listening")
            began = time.perf_counter()
            if listeners and newest is not None and newest.message.time != drawn and began >= due:
                drawn, due = newest.message.time, began + self._period
                self._show(newest.message)
                statistics.cycle(began)
            else:
                statistics.idle()

    def close(self) -> None:
        """Close the ROS node and free the graphics memory."""
        self._side.close()
        self._view.close()

    def _show(self, truth: GroundTruth) -> None:
        header = Header(frame_id=self._frame)
        header.stamp.sec, header.stamp.nanosec = divmod(truth.time, 1_000_000_000)
        image = self._view.draw(
            Posture(
                1e-9 * truth.time, "", truth.pelvis_position_in_world, truth.pelvis_orientation_in_world,
                truth.joint_position, truth.fixture_position,
            )
        )  # fmt: skip
        packed = io.BytesIO()
        Pillow.fromarray(image).save(packed, "JPEG", quality=QUALITY)
        self._infos.publish(_info(header))
        self._images.publish(CompressedImage(header=header, format="jpeg", data=packed.getvalue()))


def _info(header: Header) -> CameraInfo:
    pinhole = intrinsics()
    return CameraInfo(
        header=header, height=HEIGHT, width=WIDTH, distortion_model="plumb_bob", d=[0.0] * 5,
        k=pinhole.ravel(), r=np.eye(3).ravel(), p=np.column_stack([pinhole, np.zeros(3)]).ravel(),
    )  # fmt: skip


def body_of(robot: RobotDescription) -> str:
    """Return the body that carries the camera: the head, or else the chest."""
    return robot.tables.head or robot.tables.chest


def pose_in_body(robot: RobotDescription) -> Pose:
    """Return the camera pose in the body that carries it; optical frame of REP 103: z ahead, x right, y down.

    The camera is in front of the middle of the body and its children. With all joints at 0 it looks in the direction of
    the left sole, down by ``DOWN``.
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


def view(robot: RobotDescription, world: str, seed: int) -> Scene:
    """Return the scene seen by the camera. Raises RenderingError: off-screen OpenGL is not available."""
    place = pose_in_body(robot)

    def add(spec: mujoco.MjSpec) -> None:
        body = spec.body(body_of(robot))
        turned = np.array(place.rotation) @ np.diag([1.0, -1.0, -1.0])  # MuJoCo's camera looks along -z, with y up
        body.add_camera(name=_NAME, pos=place.position, quat=_quaternion(turned), fovy=math.degrees(FIELD_OF_VIEW))

    scene = Scene(robot, WIDTH, HEIGHT, world, seed, quality=_DETAIL, add=add)
    scene.look_through(_NAME)
    return scene


def intrinsics() -> FloatArray:
    """Return (3, 3) of a pinhole without distortion [pixels]."""
    return np.array([[FOCAL_LENGTH, 0.0, WIDTH / 2], [0.0, FOCAL_LENGTH, HEIGHT / 2], [0.0, 0.0, 1.0]])


def _quaternion(rotation: FloatArray) -> Quaternion:
    turned = np.empty(4)
    mujoco.mju_mat2Quat(turned, np.ascontiguousarray(rotation).ravel())
    w, x, y, z = map(float, turned)
    return (w, x, y, z)


def _carries(model: mujoco.MjModel, body: int, other: int) -> bool:
    while other > body:
        other = int(model.body_parentid[other])
    return other == body


def _box(model: mujoco.MjModel, data: mujoco.MjData, geom: int, level: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) lowest and (3,) highest coordinates [m] of a shape's bounding box in the axes ``level``."""
    rotation = level @ data.geom_xmat[geom].reshape(3, 3)
    middle = level @ data.geom_xpos[geom] + rotation @ model.geom_aabb[geom, :3]
    half = np.abs(rotation) @ model.geom_aabb[geom, 3:]
    return middle - half, middle + half
