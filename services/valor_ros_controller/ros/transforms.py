"""``/tf`` and ``/tf_static``: the links of the robot under ``odom``, with REP-120's frames."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from valor_common.messages import MotionState
from valor_common.robot import RobotDescription
from valor_ros_controller.kinematic_tree import KinematicTree

Vector = npt.NDArray[np.float64]

ODOM = "odom"
FOOTPRINT = "base_footprint"


def multiply(a: Vector, b: Vector) -> Vector:
    """Products of quaternions (…, 4), (w, x, y, z)."""
    w1, x1, y1, z1 = np.moveaxis(a, -1, 0)
    w2, x2, y2, z2 = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ],
        axis=-1,
    )


def rotate(q: Vector, v: Vector) -> Vector:
    """Vectors (…, 3) turned by quaternions (…, 4)."""
    w, u = q[..., :1], q[..., 1:]
    t = 2.0 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


class LinkTransforms:
    """Every link in its parent's frame for given joint angles.

    Attributes:
        position: (k, 3) [m].
        orientation: (k, 4).
    """

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
        self.position = self._offset.copy()
        self.orientation = self._fixed.copy()

    def update(self, joint_position: Vector) -> None:
        """Take the angles of all joints of the robot (n,) [rad]."""
        half = 0.5 * joint_position[self._joints]
        self._turn[self._moving, 0] = np.cos(half)
        self._turn[self._moving, 1:] = np.sin(half)[:, None] * self._axis[self._moving]
        self.orientation = multiply(self._fixed, self._turn)
        if self._eccentric:  # the hinge's anchor stays where it is
            self.position = self._offset + rotate(self._fixed, self._anchor) - rotate(self.orientation, self._anchor)

    def in_base(self, link: str, point: Vector) -> Vector:
        """A point fixed to a link (3,), in the base's frame."""
        while link in self._number:
            i = self._number[link]
            point = self.position[i] + rotate(self.orientation[i], point)
            link = self._parent[i]
        return point


def _fill(transform: TransformStamped, position: list[float], orientation: list[float]) -> None:
    translation, rotation = transform.transform.translation, transform.transform.rotation
    translation.x, translation.y, translation.z = position
    rotation.w, rotation.x, rotation.y, rotation.z = orientation


def _transform(parent: str, child: str, stamp: Time) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.header.stamp = stamp
    return message


class TransformPublisher:
    """Publishes the transforms; one message, filled anew each time."""

    def __init__(self, node: Node, tree: KinematicTree, robot: RobotDescription, stamp: Time) -> None:
        """Publish what is fixed, and prepare what moves.

        Args:
            node: the ROS node.
            tree: links and frames.
            robot: its description.
            stamp: robot time, kept up to date by its owner.
        """
        self._links = LinkTransforms(tree, robot)
        self._soles = [
            next((frame.link, np.array(frame.position)) for frame in tree.frames if frame.target == foot.sole)
            for foot in (robot.tables.feet.left, robot.tables.feet.right)
        ]
        base = tree.base_frame
        self._base = _transform(ODOM, base, stamp)
        self._footprint = _transform(ODOM, FOOTPRINT, stamp)
        self._moving = [
            _transform(base if link.parent == tree.base else link.parent, link.name, stamp) for link in tree.links
        ]
        self._message = TFMessage(transforms=[self._base, self._footprint, *self._moving])
        self._publisher = node.create_publisher(TFMessage, "/tf", 100)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._static = node.create_publisher(TFMessage, "/tf_static", latched)
        fixed = []
        if base != tree.base:  # links keep the names of the model's bodies; the base has both
            transform = _transform(base, tree.base, Time())
            _fill(transform, [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
            fixed.append(transform)
        for frame in tree.frames:
            transform = _transform(base if frame.link == tree.base else frame.link, frame.name, Time())
            _fill(transform, list(frame.position), list(frame.orientation))
            fixed.append(transform)
        self._static.publish(TFMessage(transforms=fixed))

    def publish(self, joint_position: Vector, motion: MotionState) -> None:
        """Publish the transforms of a state."""
        links = self._links
        links.update(joint_position)
        base_position, base_orientation = motion.pelvis_position_in_odom, motion.pelvis_orientation_in_odom
        for transform, position, orientation in zip(
            self._moving, links.position.tolist(), links.orientation.tolist(), strict=True
        ):
            _fill(transform, position, orientation)
        _fill(self._base, base_position.tolist(), base_orientation.tolist())
        left, right = (
            base_position + rotate(base_orientation, links.in_base(link, point)) for link, point in self._soles
        )
        middle = 0.5 * (left + right)
        w, x, y, z = base_orientation.tolist()
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        _fill(
            self._footprint,
            [float(middle[0]), float(middle[1]), float(min(left[2], right[2]))],
            [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)],
        )
        self._publisher.publish(self._message)
