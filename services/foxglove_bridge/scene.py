"""``/valor/scene``: soles, contact forces, CoM, DCM, CoP and footsteps from ROS topics, and the simulated world.

Foxglove draws the robot itself from ``/robot_description`` and ``/tf``. Frames are those of the messages. Entities
without messages are removed.
"""

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import foxglove
import numpy as np
from foxglove.channels import SceneUpdateChannel
from foxglove.messages import (
    ArrowPrimitive,
    CubePrimitive,
    LinePrimitive,
    LinePrimitiveLineType,
    SceneEntity,
    SceneEntityDeletion,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
)
from geometry_msgs.msg import PointStamped, WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Foot as Side

import bifrost
from valor.common.instance import Settings
from valor.common.messages import GroundTruth
from valor.drawing.marks import BALANCE, LEFT, RIGHT
from valor.foxglove_bridge.shapes import along, color, of_ros, points, pose, size, stamp
from valor.robot.description import RobotDescription
from valor.robot.tables import Foot
from valor.ros.limbs import FEET, HANDS, WRENCH
from valor.ros.taking import polled, waiting

TOPIC = "/valor/scene"
PERIOD = 0.1  # [s]
STALE = 0.5  # Timeout of an entity without messages [s]
METRES = 1e-3  # Scale of force arrows [m/N]
TURNED = 1e-3  # Least rotation that updates fixtures [rad]
LEAST = 1.0  # Least force shown [N]

LIMBS = FEET + HANDS

Make = Callable[[str, Any], SceneEntity]

_FEEDBACK = "robot_controllers/footstep_controller/execute_feedback"
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_CORNERS = (("toe", 1.0), ("heel", 1.0), ("heel", -1.0), ("toe", -1.0))


class _Source:
    """Topic of an entity."""

    def __init__(self, name: str, topic: str, message_type: type, make: Make, qos: QoSProfile | int = 1) -> None:
        self.name, self._topic, self.type, self.make, self._qos = name, topic, message_type, make, qos
        self._lasting = isinstance(qos, QoSProfile)  # latched: valid until the next message
        self._subscription: Any = None
        self._heard = 0.0
        self._shown = False

    def open(self, node: Any) -> None:
        """Subscribe."""
        self._subscription = polled(node, self.type, self._topic, self._qos)
        self._shown = False

    def close(self, node: Any) -> None:
        """End the subscription."""
        node.destroy_subscription(self._subscription)

    def look(self, now: float) -> Any | None:
        """Return the latest message, or None without a new one."""
        newest = None
        for message in waiting(self._subscription):
            newest = message
        if newest is not None:
            self._heard, self._shown = now, True
        return newest

    def gone(self, now: float) -> bool:
        """Return whether the entity has timed out and must be removed."""
        gone = self._shown and not self._lasting and now - self._heard > STALE
        self._shown = self._shown and not gone
        return gone


class Scene:
    """Scene, published while a client watches it."""

    def __init__(
        self, node: Any, context: foxglove.Context, settings: Settings, robot: RobotDescription,
        truth: bifrost.Subscriber[GroundTruth] | None,
    ) -> None:  # fmt: skip
        """Create the scene; ``truth`` is of the simulated world, None without one."""
        self._node, self._settings, self._robot, self._truth = node, settings, robot, truth
        feet = (robot.tables.feet.left, robot.tables.feet.right)
        self._channel = SceneUpdateChannel(TOPIC, context=context)
        self._world: Any = None
        self._frame = ""  # frame of the world; empty before it is shown
        # Positions of its joints, actual and shown [rad].
        self._positions, self._turned = np.zeros(0), np.zeros(0)
        soles = dict(zip(FEET, feet, strict=True))
        wrenches = ((limb, WRENCH.format(limb), partial(_contact, foot=soles.get(limb))) for limb in LIMBS)
        balls = ((name, f"flor/state/{name}", partial(_ball, rgb=rgb)) for name, rgb in BALANCE.items())
        plan = partial(_footsteps, feet=feet)
        self._sources = [
            *(_Source(name, topic, WrenchStamped, make) for name, topic, make in wrenches),
            *(_Source(name, topic, PointStamped, make) for name, topic, make in balls),
            _Source("footsteps", _FEEDBACK, ExecuteStepPlan.Impl.FeedbackMessage, plan, _LATCHED),
        ]
        self._open = False
        self._next = 0.0

    def follow(self, watched: frozenset[int], new: frozenset[int]) -> None:
        """Start with the first client, restart for a new one, end without clients."""
        channel = self._channel.id()
        if self._open and (channel not in watched or channel in new):
            for source in self._sources:
                source.close(self._node)
            self._open = False
        if channel in watched and not self._open:
            for source in self._sources:
                source.open(self._node)
            self._open, self._frame = True, ""

    def show(self) -> int:
        """Publish changes ten times a second; return the number of messages."""
        now = time.monotonic()
        if not self._open or now < self._next:
            return 0
        self._next = now + PERIOD
        entities, deletions = [], []
        for source in self._sources:
            message = source.look(now)
            if message is not None:
                entities.append(source.make(source.name, message))
                if source.type is PointStamped and not self._frame:
                    entities += self._ground(message.header.frame_id)
            elif source.gone(now):
                deletions.append(SceneEntityDeletion(id=source.name))
        entities += self._fixtures()
        if entities or deletions:
            self._channel.log(SceneUpdate(entities=entities, deletions=deletions), log_time=time.time_ns())
        return bool(entities or deletions)

    def _ground(self, frame: str) -> list[SceneEntity]:
        """Ground of the simulated world, in the robot's estimated frame."""
        self._frame, self._turned = frame, np.zeros(0)
        if self._settings.variant == "hardware":
            return []
        if self._world is None:
            from valor.foxglove_bridge.world import World  # imports MuJoCo only with a client

            self._world = World(self._settings, self._robot)
        return [self._world.ground(frame)]

    def _fixtures(self) -> list[SceneEntity]:
        """Fixtures of the simulated world, if they have moved."""
        if self._truth is not None and (received := self._truth.latest()) is not None:
            self._positions = received.message.fixture_position
        positions, turned = self._positions, self._turned
        if self._world is None or not self._frame:
            return []
        if turned.size == positions.size and np.abs(positions - turned).max(initial=0.0) < TURNED:
            return []
        self._turned = positions
        entity = self._world.fixtures(self._frame, positions)
        return [] if entity is None else [entity]


def _ball(name: str, message: Any, *, rgb: str) -> SceneEntity:
    """Ball at a point of balance."""
    header, at = message.header, pose((message.point.x, message.point.y, message.point.z))
    ball = SpherePrimitive(pose=at, size=size(0.04, 0.04, 0.04), color=color(rgb))
    return SceneEntity(
        timestamp=stamp(header.stamp), frame_id=header.frame_id, id=name, frame_locked=True, spheres=[ball]
    )


def _contact(name: str, message: Any, *, foot: Foot | None) -> SceneEntity:
    """Contact force of a foot or hand, and the outline of a sole."""
    force = message.wrench.force
    vector = (force.x, force.y, force.z)
    newtons = math.hypot(*vector)
    rgb = LEFT if name in (FEET[0], HANDS[0]) else RIGHT
    arrows, lines = [], []
    if newtons > LEAST:
        shaft = METRES * newtons
        arrows.append(
            ArrowPrimitive(
                pose=pose((0.0, 0.0, 0.0), along(vector)), shaft_length=shaft, shaft_diameter=0.02,
                head_length=0.06, head_diameter=0.05, color=color(rgb),
            )
        )  # fmt: skip
    if foot is not None:
        corners = [(getattr(foot, end), side * foot.half_width, 0.0) for end, side in _CORNERS]
        loop = LinePrimitiveLineType.LineLoop
        lines.append(LinePrimitive(type=loop, thickness=0.006, points=points(corners), color=color(rgb)))
    return SceneEntity(
        timestamp=stamp(message.header.stamp), frame_id=message.header.frame_id, id=name, frame_locked=True,
        arrows=arrows, lines=lines,
    )  # fmt: skip


def _footsteps(name: str, message: Any, *, feet: tuple[Foot, Foot]) -> SceneEntity:
    """Running plan with numbered steps."""
    cubes, texts, plan = [], [], message.feedback.feedback
    for step in plan.steps:
        left = step.foot.foot_index == Side.LEFT
        foot, rgb = feet[0 if left else 1], LEFT if left else RIGHT
        # A sole's frame is not in its middle: the box has the longer half-length on both sides.
        extent = size(2.0 * max(foot.toe, -foot.heel), 2.0 * foot.half_width, 0.01)
        cubes.append(CubePrimitive(pose=of_ros(step.foot.pose), size=extent, color=color(rgb, 0.6)))
        texts.append(
            TextPrimitive(
                pose=of_ros(step.foot.pose, lift=0.05), billboard=True, font_size=0.06, color=color("202020"),
                text=str(step.step_index),
            )
        )  # fmt: skip
    header = plan.header
    return SceneEntity(
        timestamp=stamp(header.stamp), frame_id=header.frame_id, id=name, frame_locked=True, cubes=cubes, texts=texts
    )
