"""The loop: ground truth in; images, depth and clouds out while a ROS 2 node subscribes, as by ``multisense_ros``."""

import array
import io
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image as Pillow
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import Header

from valor.common.errors import ConfigurationError
from valor.common.messages import GroundTruth
from valor.common.processes import BY_NAME, HEAD_CAMERA
from valor.common.topics import GROUND_TRUTH
from valor.drawing import Posture, RenderingError
from valor.head_camera.multisense import HEIGHT, RATE, WIDTH, Multisense, Picture, intrinsics
from valor.ros.clouds import cloud, header
from valor.ros.node import RosSide
from valor.ros.parameters import Parameters, Range
from valor.ros.transforms import publish_mount
from valor.service import Context, quiet_collector

FRAME = "multisense/left_camera_optical_frame"
COLOR = "multisense/left/image_rect_color"
IMAGES: dict[str, tuple[str, Callable[[Picture], npt.NDArray[Any]]]] = {
    COLOR: ("bgr8", Picture.bgr),
    "multisense/left/depth": ("32FC1", Picture.depth),
    "multisense/left/openni_depth": ("16UC1", Picture.millimetres),
}
CLOUD = "multisense/image_points2_color"
SHARE = 0.5  # of a core that pictures may take
PREVIEW = 0.5  # Period of compressed pictures, and of all while nothing else has a subscriber [s]
QUALITY = 80  # JPEG quality
IDLE = 0.1  # Polling period of subscriptions [s]
NEXT = 0.005  # Polling period of the next picture's ground truth [s]
_INFO = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class HeadCamera:
    """``multisense/…``; its frame in ``/tf_static``.

    Raises ConfigurationError: the robot has no camera, or off-screen OpenGL is not available.
    """

    def __init__(self, context: Context) -> None:
        self._context, settings = context, context.settings
        self._truth = GROUND_TRUTH.subscriber(context.node)
        try:
            self._camera = Multisense(context.robot, settings.world, settings.seed)
        except RenderingError as error:
            raise ConfigurationError(f"{BY_NAME[HEAD_CAMERA].option}: {error}") from None
        self._side = RosSide(context.name, settings, context.instance.environment(), context.arguments)
        node, prefix = self._side.node, settings.frame_prefix
        rates = Range(0.1, RATE)
        self._period = 1.0 / Parameters(node).declare("update_rate", RATE, "of pictures, at most [Hz]", rates)
        self._frame = prefix + FRAME
        self._images = {name: node.create_publisher(Image, name, 1) for name in IMAGES}
        self._infos = [node.create_publisher(CameraInfo, f"{name}/camera_info", _INFO) for name in IMAGES]
        self._clouds = node.create_publisher(PointCloud2, CLOUD, 1)
        self._previews = node.create_publisher(CompressedImage, f"{COLOR}/compressed", 1)
        self._preview_due = 0.0
        self._drawn = deque[float](maxlen=16)  # times [s]
        publish_mount(node, prefix + self._camera.body, self._frame, self._camera.pose)
        self._side.life.configure()

    def run(self) -> None:
        """Draw until stopped."""
        quiet_collector()
        statistics, stopping = self._context.statistics, self._context.stopping
        self._side.life.set_ready(True)
        shown, due, pause = -1, 0.0, IDLE
        while not stopping.wait(pause):
            self._side.serve_pending()
            newest = self._truth.latest()
            streams, previews = _listeners([*self._images.values(), self._clouds]), _listeners(self._small)
            statistics.state("ready", f"{streams + previews} listening{self._rate()}")
            began = time.perf_counter()
            wanted = began >= due if streams else previews and began >= self._preview_due
            if wanted and newest is not None and newest.message.time != shown:
                shown, used = newest.message.time, time.process_time()
                self._show(newest.message, began)
                due = began + max(self._period, (time.process_time() - used) / SHARE)
                statistics.cycle(began)
            else:
                statistics.idle()
            pause = min(IDLE, max(NEXT, due - time.perf_counter())) if streams else IDLE

    def close(self) -> None:
        """Close the ROS node and free the graphics memory."""
        self._side.close()
        self._camera.close()

    @property
    def _small(self) -> list[Any]:
        return [self._previews, *self._infos]

    def _rate(self) -> str:
        """Rate of the last pictures; empty if there is none."""
        times = self._drawn
        if len(times) < 2 or time.perf_counter() - times[-1] > 2.0:
            times.clear()
            return ""
        return f", {(len(times) - 1) / (times[-1] - times[0]):.1f} Hz"

    def _show(self, truth: GroundTruth, now: float) -> None:
        picture = self._camera.look(
            Posture(
                1e-9 * truth.time, "", truth.pelvis_position_in_world, truth.pelvis_orientation_in_world,
                truth.joint_position, truth.fixture_position,
            )
        )  # fmt: skip
        self._drawn.append(now)
        head = header(truth.time, self._frame)
        for publisher in self._infos:
            publisher.publish(_info(head))
        for name, (encoding, pixels) in IMAGES.items():
            if self._images[name].get_subscription_count():
                self._images[name].publish(_image(head, encoding, pixels(picture)))
        if self._clouds.get_subscription_count():
            self._clouds.publish(cloud(head, picture.points()))
        if now >= self._preview_due and self._previews.get_subscription_count():
            packed = io.BytesIO()
            Pillow.fromarray(picture.image).save(packed, "JPEG", quality=QUALITY)
            self._previews.publish(CompressedImage(header=head, format="jpeg", data=packed.getvalue()))
        if now >= self._preview_due:
            self._preview_due = now + PREVIEW


def _listeners(publishers: list[Any]) -> int:
    return sum(each.get_subscription_count() for each in publishers)


def _image(head: Header, encoding: str, pixels: npt.NDArray[Any]) -> Image:
    data = array.array("B", pixels.tobytes())
    return Image(header=head, height=HEIGHT, width=WIDTH, encoding=encoding, step=len(data) // HEIGHT, data=data)


def _info(head: Header) -> CameraInfo:
    pinhole = intrinsics()
    return CameraInfo(
        header=head, height=HEIGHT, width=WIDTH, distortion_model="plumb_bob", d=[0.0] * 5,
        k=pinhole.ravel(), r=np.eye(3).ravel(), p=np.column_stack([pinhole, np.zeros(3)]).ravel(),
    )  # fmt: skip
