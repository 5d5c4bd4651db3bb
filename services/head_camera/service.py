"""The loop: where the simulated robot is becomes a picture, at a rate, while somebody listens on ROS 2."""

from __future__ import annotations

import io
import time

import numpy as np
from geometry_msgs.msg import TransformStamped
from PIL import Image as Pillow
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from valor.common.errors import ConfigurationError
from valor.common.messages import GroundTruth
from valor.common.processes import CAMERA
from valor.common.topics import GROUND_TRUTH
from valor.drawing.errors import RenderingError
from valor.drawing.posture import Posture
from valor.head_camera import eye
from valor.ros.node import RosSide
from valor.ros.parameters import Parameters, Range
from valor.service import Context, quiet_collector

FRAME = "head_camera_optical_frame"
RATE = 2.0  # of pictures, of robot time that goes as the wall's [Hz]
QUALITY = 80  # of a JPEG
PERIOD = 0.1  # between two looks whether anybody listens [s]
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class HeadCamera:
    """``camera/image_raw/compressed`` and ``camera/camera_info``; its frame in ``/tf_static``.

    Raises:
        ConfigurationError: there is no off-screen OpenGL here; names what to install.
    """

    def __init__(self, context: Context) -> None:
        self._context, settings, robot = context, context.settings, context.robot
        self._truth = GROUND_TRUTH.subscriber(context.node)
        try:
            self._eye = eye.Eye(robot, settings.world, settings.seed)
        except RenderingError as error:
            raise ConfigurationError(f"{CAMERA}: {error}") from None
        self._side = RosSide(context.name, settings, context.instance.environment(), context.arguments)
        node, prefix = self._side.node, settings.frame_prefix
        rates = Range(0.1, 10.0)
        self._period = 1.0 / Parameters(node).declare("update_rate", RATE, "of pictures, at most [Hz]", rates)
        self._frame = prefix + FRAME
        self._images = node.create_publisher(CompressedImage, "camera/image_raw/compressed", qos_profile_sensor_data)
        self._infos = node.create_publisher(CameraInfo, "camera/camera_info", qos_profile_sensor_data)
        self._fixed = node.create_publisher(TFMessage, "/tf_static", _LATCHED)
        self._fixed.publish(TFMessage(transforms=[self._mount(prefix + eye.body_of(robot))]))
        self._side.life.configured()

    def run(self) -> None:
        """Draw until told to stop."""
        quiet_collector()
        statistics, stopping = self._context.statistics, self._context.stopping
        self._side.life.tell(True)
        drawn, due = -1, 0.0
        while not stopping.wait(PERIOD):
            self._side.attend()
            newest = self._truth.latest()
            listeners = self._images.get_subscription_count() + self._infos.get_subscription_count()
            statistics.state("ready", f"{listeners or 'nobody'} listening")
            began = time.perf_counter()
            if listeners and newest is not None and newest.message.time != drawn and began >= due:
                drawn, due = newest.message.time, began + self._period
                self._show(newest.message)
                statistics.cycle(began)
            else:
                statistics.idle()

    def close(self) -> None:
        """Leave ROS, and give the graphics memory back."""
        self._side.close()
        self._eye.close()

    def _show(self, truth: GroundTruth) -> None:
        header = Header(frame_id=self._frame)
        header.stamp.sec, header.stamp.nanosec = divmod(truth.time, 1_000_000_000)
        image = self._eye.see(
            Posture(
                1e-9 * truth.time, "", truth.pelvis_position_in_world, truth.pelvis_orientation_in_world,
                truth.joint_position, truth.fixture_position,
            )
        )  # fmt: skip
        packed = io.BytesIO()
        Pillow.fromarray(image).save(packed, "JPEG", quality=QUALITY)
        self._infos.publish(_info(header))
        self._images.publish(CompressedImage(header=header, format="jpeg", data=packed.getvalue()))

    def _mount(self, parent: str) -> TransformStamped:
        place = eye.pose_in_body(self._context.robot)
        made = TransformStamped(child_frame_id=self._frame)
        made.header.frame_id = parent
        translation, rotation = made.transform.translation, made.transform.rotation
        translation.x, translation.y, translation.z = place.position
        rotation.w, rotation.x, rotation.y, rotation.z = place.orientation
        return made


def _info(header: Header) -> CameraInfo:
    pinhole = eye.intrinsics()
    return CameraInfo(
        header=header, height=eye.HEIGHT, width=eye.WIDTH, distortion_model="plumb_bob", d=[0.0] * 5,
        k=pinhole.ravel(), r=np.eye(3).ravel(), p=np.column_stack([pinhole, np.zeros(3)]).ravel(),
    )  # fmt: skip
