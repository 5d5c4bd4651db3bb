"""``/tf``: links of the robot under ``odom``, with REP-120's frames."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.poses import Pose
from valor.common.rotation import Quaternion, Vector
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree
from valor.ros.prepared_message import PreparedPublisher, mark, stamp_mark

ODOM = "odom"
FOOTPRINT = "base_footprint"
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of quaternions (…, 4), (w, x, y, z)."""
    return np.stack(rotation.multiply(_columns(a), _columns(b)), axis=-1)


def rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Vectors (…, 3) rotated by quaternions (…, 4)."""
    return np.stack(rotation.rotate(_columns(q), _columns(v)), axis=-1)


def _columns(array: FloatArray) -> Any:
    """Columns of an array, on which scalar formulas work as on numbers."""
    return np.moveaxis(array, -1, 0)


class LinkTransforms:
    """Transform of each link to its parent for given joint angles."""

    def __init__(self, tree: KinematicTree, robot: RobotDescription) -> None:
        links = tree.links
        self._fixed = np.array([link.orientation for link in links])
        self._offset = np.array([link.position for link in links])
        self._axis = np.array([link.axis for link in links])
        self._anchor = np.array([link.anchor for link in links])
        self._moving = np.array([i for i, link in enumerate(links) if link.joint], dtype=np.intp)
        self._joints = np.array([robot.index[link.joint] for link in links if link.joint], dtype=np.intp)
        self._eccentric = bool(self._anchor.any())
        self._turn = np.zeros((len(links), 4))
        self._turn[:, 0] = 1.0
        self._number = {link.name: i for i, link in enumerate(links)}
        self._parent = [link.parent for link in links]
        self.position = self._offset.copy()  # (k, 3) [m]
        self.orientation = self._fixed.copy()  # (k, 4) (w, x, y, z)

    def update(self, joint_position: FloatArray) -> None:
        """Set the angles of all joints of the robot (n,) [rad]."""
        half = 0.5 * joint_position[self._joints]
        self._turn[self._moving, 0] = np.cos(half)
        self._turn[self._moving, 1:] = np.sin(half)[:, None] * self._axis[self._moving]
        self.orientation = multiply(self._fixed, self._turn)
        if self._eccentric:  # the hinge's anchor stays where it is
            self.position = self._offset + rotate(self._fixed, self._anchor) - rotate(self.orientation, self._anchor)

    def in_base(self, link: str, point: Vector) -> Vector:
        """Point fixed to a link, in the base's frame [m]."""
        while (i := self._number.get(link)) is not None:
            point = _moved(self.position[i].tolist(), self.orientation[i].tolist(), point)
            link = self._parent[i]
        return point


def _moved(position: Sequence[float], orientation: Quaternion, point: Vector) -> Vector:
    a, b, c = rotation.rotate(orientation, point)
    return position[0] + a, position[1] + b, position[2] + c


def _transform(parent: str, child: str, stamp: Time, numbers: Sequence[float]) -> TransformStamped:
    """``numbers``: translation x, y, z and rotation x, y, z, w."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.header.stamp = stamp
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = numbers[:3]
    rotation.x, rotation.y, rotation.z, rotation.w = numbers[3:]
    return message


def _numbers(position: Sequence[float], orientation: Sequence[float]) -> tuple[float, ...]:
    """Translation x, y, z and rotation x, y, z, w of a position and a quaternion (w, x, y, z)."""
    w, *vector = orientation
    return (*position, *vector, w)


def publish_mount(node: Node, parent: str, child: str, pose: Pose) -> None:
    """Publish the constant pose of a frame in its parent on ``/tf_static``."""
    message = _transform(parent, child, Time(), _numbers(pose.position, pose.orientation))
    node.create_publisher(TFMessage, "/tf_static", _LATCHED).publish(TFMessage(transforms=[message]))


class TransformPublisher:
    """Publishes the transforms in one prepared message; ``fixed``: constant ones, for ``/tf_static``."""

    def __init__(
        self, node: Node, tree: KinematicTree, robot: RobotDescription, stamp: Time, *, prefix: str = ""
    ) -> None:
        """``stamp``: robot time, updated by its owner; ``prefix``: of all frames' names."""
        self._links = LinkTransforms(tree, robot)
        soles = {frame.target: (frame.link, frame.position) for frame in tree.frames}
        self._soles = [soles[robot.tables.feet.left.sole], soles[robot.tables.feet.right.sole]]
        base = tree.base_frame

        def frame_name(link: str) -> str:
            return prefix + (base if link == tree.base else link)

        edges = [(prefix + ODOM, prefix + base), (prefix + ODOM, prefix + FOOTPRINT)]
        edges += [(frame_name(link.parent), prefix + link.name) for link in tree.links]
        marks = [
            _transform(parent, child, stamp_mark(), [mark(7 * i + j) for j in range(7)])
            for i, (parent, child) in enumerate(edges)
        ]
        self._moving = PreparedPublisher(
            node, "/tf", TFMessage(transforms=marks), 7 * len(edges), stamp=stamp, queue=100
        )
        self._rows = self._moving.values.reshape(-1, 7)

        fixed = [(frame.link, frame.name, frame.position, frame.orientation) for frame in tree.frames]
        if base != tree.base:  # links have the names of the model's bodies; the base has both names
            fixed.insert(0, (tree.base, tree.base, (0.0, 0.0, 0.0), rotation.IDENTITY))
        self.fixed: list[TransformStamped] = [
            _transform(frame_name(link), prefix + name, Time(), _numbers(position, orientation))
            for link, name, position, orientation in fixed
        ]

    def publish(self, joint_position: FloatArray, base_position: FloatArray, base_orientation: FloatArray) -> None:
        """Publish the transforms of joints (n,) [rad] and of the pelvis in odom: (3,) [m], (4,) (w, x, y, z)."""
        links, rows = self._links, self._rows
        links.update(joint_position)
        position, orientation = base_position.tolist(), base_orientation.tolist()  # faster than NumPy's scalars
        left, right = (_moved(position, orientation, links.in_base(link, point)) for link, point in self._soles)
        middle = (0.5 * (left[0] + right[0]), 0.5 * (left[1] + right[1]), min(left[2], right[2]))
        rows[0] = _numbers(position, orientation)
        rows[1] = _numbers(middle, rotation.about_z(rotation.heading(orientation)))
        rows[2:, :3] = links.position
        rows[2:, 3:6] = links.orientation[:, 1:]
        rows[2:, 6] = links.orientation[:, 0]
        self._moving.publish()
