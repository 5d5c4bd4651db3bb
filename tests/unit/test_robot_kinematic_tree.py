"""The links and frames of tf stand where MuJoCo's kinematics puts them."""

from typing import Any

import mujoco
import numpy as np
import pytest

from harness.places import ROBOTS
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree
from valor.robot.model import full_model
from valor.ros.prepared_message import PreparedMessage, mark, stamp_mark
from valor.ros.transforms import LinkTransforms, multiply, rotate


@pytest.mark.parametrize("name", [path.parent.name for path in ROBOTS.glob("*/robot.yaml")])
def test_links_and_frames_stand_where_mujoco_puts_them(name: str) -> None:
    robot = RobotDescription.load(ROBOTS / name)
    tree = KinematicTree.load(robot)
    model = full_model(robot)
    data = mujoco.MjData(model.mj)
    rng = np.random.default_rng(1)
    angles = rng.uniform(-1.0, 1.0, len(robot.joints))
    base_position, base_orientation = rng.normal(size=3), np.array([0.5, -0.5, 0.1, 0.7])
    base_orientation /= np.linalg.norm(base_orientation)
    data.qpos[:7] = (*base_position, *base_orientation)
    data.qpos[model.qpos] = angles[model.joint_indices]
    mujoco.mj_kinematics(model.mj, data)

    transforms = LinkTransforms(tree, robot)
    transforms.update(angles)
    poses = {tree.base: (base_position, base_orientation)}
    for i, link in enumerate(tree.links):
        position, orientation = poses[link.parent]
        poses[link.name] = (
            position + rotate(orientation, transforms.position[i]),
            multiply(orientation, transforms.orientation[i]),
        )
    assert len(poses) == model.mj.nbody - 1
    for name, (position, orientation) in poses.items():
        body = model.body(name)
        assert position == pytest.approx(data.xpos[body], abs=1e-12), name
        assert abs(orientation @ data.xquat[body]) == pytest.approx(1.0), name
    for side in ("left", "right"):
        sole = getattr(robot.tables.feet, side).sole
        frame = next(frame for frame in tree.frames if frame.target == sole)
        in_base = np.array(transforms.in_base(frame.link, frame.position))
        assert base_position + rotate(base_orientation, in_base) == pytest.approx(data.site_xpos[model.site(sole)])


def test_a_prepared_message_is_what_rclpy_would_have_sent() -> None:
    from builtin_interfaces.msg import Time
    from geometry_msgs.msg import TransformStamped
    from rclpy.serialization import deserialize_message, serialize_message
    from tf2_msgs.msg import TFMessage

    def message(stamp: Any, numbers: Any) -> Any:
        made = TFMessage()
        for child, row in zip(("a", "longer_name", "c"), numbers, strict=True):
            transform = TransformStamped(child_frame_id=child)
            transform.header.stamp = stamp
            transform.header.frame_id = "odom"
            translation, rotation = transform.transform.translation, transform.transform.rotation
            translation.x, translation.y, translation.z, rotation.x, rotation.y, rotation.z, rotation.w = row
            made.transforms.append(transform)
        return made

    prepared = PreparedMessage(message(stamp_mark(), np.reshape([mark(i) for i in range(21)], (3, 7)).tolist()), 21)
    stamp = Time(sec=12, nanosec=345)
    for seed in (1, 2):
        prepared.values[:] = np.random.default_rng(seed).normal(size=21)
        wanted = message(stamp, prepared.values.reshape(3, 7).tolist())
        assert len(prepared.serialized(stamp)) == len(serialize_message(wanted))  # padding may differ
        assert deserialize_message(prepared.serialized(stamp), TFMessage) == wanted
    with pytest.raises(ValueError, match="marked numbers"):
        PreparedMessage(wanted, 21)
