"""Where the frames of plans are, from ``/tf`` and ``/tf_static``.

``/tf`` comes all the time and is hardly ever asked for: its messages are kept as the bytes that came, and read when a
plan in another frame than odom comes.
"""

from __future__ import annotations

import logging
import time
from collections import deque

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from tf2_msgs.msg import TFMessage

from valor.common.poses import Pose
from valor.common.transforms import TransformBuffer

ODOM = "odom"

HISTORY = 10.0  # for which transforms are kept [s], as tf2 does
MOST = 5000  # messages kept unread

_log = logging.getLogger("footstep_converter")


class Frames:
    """tf as this node has heard it."""

    def __init__(self, node: Node, prefix: str) -> None:
        """Args: node: that hears them; prefix: of the robot's frames."""
        self._odom = prefix + ODOM
        self._buffer = TransformBuffer(HISTORY)
        self._unread: deque[tuple[float, bytes]] = deque(maxlen=MOST)
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(TFMessage, "/tf", self._keep, 100, raw=True)
        node.create_subscription(TFMessage, "/tf_static", lambda message: self._take(message, static=True), latched)

    def in_odom(self, frame: str, stamp: int) -> Pose | None:
        """A frame in odom at a time [ns]; at 0: now. None: it is odom.

        Raises:
            TooNewError: not yet known for that time.
            TransformError: cannot be said.
        """
        if frame.lstrip("/") == self._odom:
            return None
        while self._unread:
            _, data = self._unread.popleft()
            self._take(deserialize_message(data, TFMessage), static=False)
        return self._buffer.lookup(self._odom, frame, stamp)

    def _keep(self, data: bytes) -> None:
        now = time.monotonic()
        self._unread.append((now, data))
        while now - self._unread[0][0] > HISTORY:
            self._unread.popleft()

    def _take(self, message: TFMessage, *, static: bool) -> None:
        for each in message.transforms:
            t, r, stamp = each.transform.translation, each.transform.rotation, each.header.stamp
            try:
                self._buffer.add(
                    each.header.frame_id,
                    each.child_frame_id,
                    stamp.sec * 10**9 + stamp.nanosec,
                    Pose((t.x, t.y, t.z), (r.w, r.x, r.y, r.z)),
                    static=static,
                )
            except ValueError as error:
                _log.warning("tf: %s", error)
