"""The simulated camera for a ROS 2 program: picture, pinhole, frame."""

import io

from PIL import Image
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage
from tf2_msgs.msg import TFMessage

from harness.system import RosClient, System
from harness.waiting import wait_until
from valor.common.processes import HEAD_CAMERA
from valor.head_camera.service import COLOR, FRAME

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def listening(system: System) -> int:
    """Number of subscribers that the camera reports."""
    reported = next(each for each in system.status()["services"] if each["name"] == HEAD_CAMERA)
    assert reported["state"] == "ready"
    return int(reported["detail"].split(" listening")[0])


def test_a_picture_comes_with_its_pinhole_and_its_place(system: System, ros: RosClient) -> None:
    page = listening(system)
    images: list[CompressedImage] = []
    infos: list[CameraInfo] = []
    frames: list[TFMessage] = []
    ros.node.create_subscription(TFMessage, "/tf_static", frames.append, LATCHED)
    seeing = ros.node.create_subscription(
        CompressedImage, f"/{COLOR}/compressed", images.append, qos_profile_sensor_data
    )
    measuring = ros.node.create_subscription(CameraInfo, f"/{COLOR}/camera_info", infos.append, qos_profile_sensor_data)
    wait_until(lambda: len(images) >= 3 and len(infos) >= 3, 30.0, "three pictures")
    newest, info = images[-1], infos[-1]
    with Image.open(io.BytesIO(bytes(newest.data))) as picture:
        assert (picture.format, picture.size) == ("JPEG", (info.width, info.height))
        assert len(picture.getcolors(2**24) or ()) > 100  # stairs, not a single color
    assert newest.header.frame_id == info.header.frame_id == FRAME
    stamps = [1_000_000_000 * each.header.stamp.sec + each.header.stamp.nanosec for each in images]
    assert stamps == sorted(set(stamps))
    wait_until(
        lambda: (
            ("head", newest.header.frame_id)
            in {(each.header.frame_id, each.child_frame_id) for message in frames for each in message.transforms}
        ),
        10.0,
        "where the camera is",
    )
    assert listening(system) == page + 2
    ros.node.destroy_subscription(seeing)
    ros.node.destroy_subscription(measuring)
    wait_until(lambda: listening(system) == page, 20.0, "no other subscriber reported")
