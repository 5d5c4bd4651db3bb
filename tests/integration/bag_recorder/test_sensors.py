"""A bag of camera and lidar, read by a stock tool: types, frames, and the stairs where they are."""

import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from rclpy.node import Node
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import PointCloud2

from harness.instance import RunningInstance
from harness.motion_states import motion_state
from harness.places import ROBOTS
from harness.waiting import wait_until
from valor.bags.selection import EVERYTHING, Selection
from valor.common.arrays import FloatArray
from valor.common.messages import GroundTruth
from valor.common.poses import Pose
from valor.common.topics import GROUND_TRUTH, MOTION_STATE
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.ros.taking import polled, take
from valor.valorctl.instance.checks import CHECKS

ESCHER = RobotDescription.load(ROBOTS / "escher")
PLACE = np.array([0.0, 0.0, ESCHER.tables.nominal_base_height])
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
OPTICAL = "multisense/left_camera_optical_frame"
DEPTH, CLOUDS = "/multisense/left/depth", ("/multisense/image_points2_color", "/lidar/points")
FRAMES = {
    "/multisense/left/image_rect_color": OPTICAL, f"{DEPTH}/camera_info": OPTICAL, DEPTH: OPTICAL, CLOUDS[0]: OPTICAL,
    "/multisense/left/openni_depth": OPTICAL, "/lidar/scan": "laser", CLOUDS[1]: "odom",
}  # fmt: skip
ENCODINGS = {"image_rect_color": "bgr8", "depth": "32FC1", "openni_depth": "16UC1"}


class Standing(threading.Thread):
    """A simulation in which the robot stands and its spindle turns."""

    def __init__(self, instance: RunningInstance) -> None:
        super().__init__(daemon=True)
        node = instance.node()
        self._truth, self._motion = GROUND_TRUTH.publisher(node), MOTION_STATE.publisher(node)
        self.stopping = threading.Event()

    def run(self) -> None:
        while not self.stopping.wait(0.01):
            now, joints = time.monotonic_ns(), ESCHER.nominal_posture.copy()
            joints[ESCHER.index["lidar_roll"]] = (3e-9 * now + np.pi) % (2 * np.pi) - np.pi
            feet = np.ones(2, np.uint8)
            self._truth.publish(GroundTruth(now, PLACE, UPRIGHT, np.zeros(3), np.zeros(3), joints, feet, np.zeros(0)))
            estimate = motion_state(time=now, pelvis_position_in_odom=PLACE, pelvis_orientation_in_odom=UPRIGHT)
            self._motion.publish(estimate)


def body_in_world(name: str) -> Pose:
    model = full_model(ESCHER)
    data = mujoco.MjData(model.mj)
    data.qpos[:] = model.nominal_qpos()
    mujoco.mj_kinematics(model.mj, data)
    (x, y, z), (w, a, b, c) = data.body(name).xpos.tolist(), data.body(name).xquat.tolist()
    return Pose((x, y, z), (w, a, b, c))


def assert_stairs(heights: FloatArray) -> None:
    for height in (0.0, 0.1, 0.2, 0.3):
        level = heights[np.abs(heights - height) < 0.045]
        assert level.size > 300 and np.median(level) == pytest.approx(height, abs=0.015)


def test_a_stock_tool_finds_the_stairs_in_a_bag_of_the_sensors(instance: RunningInstance, ros: Node) -> None:
    only = ["/lidar/*", "/multisense/*", "/tf_static"]
    asked = ["lidar", "head_camera"]
    instance.configure(world="stairs", asked=asked, recording={"only": only}, real_time_factor=1.0)
    simulation = Standing(instance)
    simulation.start()
    for name in (*asked, "bag_recorder"):
        instance.start(name, wait=True)
    watching = [polled(ros, PointCloud2, topic, 1, raw=True) for topic in CLOUDS]
    seen: Counter[int] = Counter()

    def two_each() -> bool:
        seen.update(i for i, each in enumerate(watching) if take(each) is not None)
        return min(seen[0], seen[1]) >= 2

    wait_until(two_each, 60.0, "two clouds of each")
    wait_until(lambda: CHECKS["sensors"](instance.instance)[0] == "ok", 60.0, "doctor sees them all")
    instance.stop("head_camera")
    level, text, *advice = CHECKS["sensors"](instance.instance)
    assert level == "warn" and "multisense/left/depth: no publisher" in text and advice
    instance.stop("bag_recorder")
    simulation.stopping.set()
    simulation.join()
    (folder,) = instance.instance.bags.glob("*/")
    last, mounts = contents(folder)
    assert {name: last[name].header.frame_id for name in FRAMES} == FRAMES
    assert {name: last[f"/multisense/left/{name}"].encoding for name in ENCODINGS} == ENCODINGS
    depth, k = last[DEPTH], last[f"{DEPTH}/camera_info"].k.reshape(3, 3)
    z = np.frombuffer(depth.data.tobytes(), "<f4").reshape(depth.height, depth.width)
    millimetres = np.frombuffer(last["/multisense/left/openni_depth"].data.tobytes(), "<u2").reshape(z.shape)
    np.testing.assert_allclose(millimetres, np.nan_to_num(1000.0 * z), atol=0.51)
    v, u = np.nonzero(z < 4.0)
    pixels = np.stack([u, v, np.ones_like(u)]) * z[v, u]
    parent, mount = mounts[OPTICAL]
    camera = body_in_world(parent) @ mount
    assert_stairs((np.array(camera.rotation) @ np.linalg.inv(k) @ pixels)[2] + camera.position[2])
    for topic, of in ((CLOUDS[0], camera), (CLOUDS[1], Pose())):
        points = np.frombuffer(last[topic].data.tobytes(), "<f4").reshape(-1, 4)[:, :3]
        near = points[np.abs(points).max(axis=1) < 4.0]
        assert_stairs((near @ np.array(of.rotation).T)[:, 2] + of.position[2])


def contents(folder: Path) -> tuple[dict[str, Any], dict[str, tuple[str, Pose]]]:
    """The last message of each topic, of clouds the largest; parents and poses of the static frames."""
    last: dict[str, Any] = {}
    mounts: dict[str, tuple[str, Pose]] = {}
    with AnyReader([folder]) as reader:
        for connection, _, data in reader.messages():
            last[connection.topic] = message = reader.deserialize(data, connection.msgtype)
            for each in getattr(message, "transforms", ()):
                p, q = each.transform.translation, each.transform.rotation
                mounts[each.child_frame_id] = each.header.frame_id, Pose((p.x, p.y, p.z), (q.w, q.x, q.y, q.z))
    return last, mounts


def test_images_depth_and_clouds_of_a_camera_are_recorded_only_if_named() -> None:
    small = ("/multisense/left/image_rect_color/compressed", "/multisense/left/depth/camera_info", "/lidar/points")
    assert all(topic in EVERYTHING for topic in small)
    for topic in (DEPTH, CLOUDS[0], "/escher1/multisense/left/image_rect_color"):
        assert topic not in EVERYTHING and topic in Selection(("*",)) and topic not in Selection(("*",), ("*",))
