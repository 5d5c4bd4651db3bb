"""Actions and topics that the link carries, and the messages between its ends.

A ROS message is serialized (CDR) and deflated with a dictionary of the robot's names; the steps of a plan are packed.
"""

import copy
import zlib
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from control_msgs.action import FollowJointTrajectory
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Empty, String
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_humanoid_control_msgs.action import ChangeControlMode
from vigir_humanoid_control_msgs.msg import VigirControlModeCommand

from valor.common.behaviors import EMERGENCY_STOP, ControlMode
from valor.link.classes import MessageClass
from valor.link.errors import SealError
from valor.robot.description import RobotDescription
from valor.ros import packed_steps
from valor.ros.controllers import COMMAND
from valor.ros.limbs import HANDS

_UNPACKED = b"\0\0"  # prefix of a plan whose steps are not packed
_TRAJECTORY = "trajectory_controllers/{}_traj_controller/follow_joint_trajectory"
_GROUPS = ("left_arm", "right_arm", "torso", "left_hand", "right_hand", "neck", "pelvis")


@dataclass(frozen=True)
class Action:
    """Action with a server at the operator's end and a client at the robot's."""

    name: str
    type: Any
    target: str


@dataclass(frozen=True)
class Command:
    """Topic that the operator's end subscribes to and the robot's publishes."""

    name: str
    type: Any
    kind: MessageClass
    target: str = ""


MODE = "mode"
"""Target of mode changes, which end the commands of all targets."""
ACTIONS: tuple[Action, ...] = (
    Action("mode_controllers/control_mode_controller/change_control_mode", ChangeControlMode, MODE),
    Action("robot_controllers/footstep_controller/execute_step_plan", ExecuteStepPlan, "steps"),
    *(Action(_TRAJECTORY.format(group), FollowJointTrajectory, group) for group in _GROUPS),
)
_ARMS = dict(zip(HANDS, ("left_arm", "right_arm"), strict=True))
COMMANDS: tuple[Command, ...] = (
    Command("flor/controller/soft_stop", Empty, MessageClass.STOP),
    Command("flor/controller/mode_command", VigirControlModeCommand, MessageClass.COMMAND, MODE),
    Command("cmd_vel", Twist, MessageClass.STREAM),
    Command("flor/pelvis_controller/goal_pose", PoseStamped, MessageClass.COMMAND, "pelvis"),
    *(Command(f"flor/{hand}/goal_pose", PoseStamped, MessageClass.COMMAND, arm) for hand, arm in _ARMS.items()),
    *(Command(f"flor/{hand}/goal_cancel", Empty, MessageClass.COMMAND, arm) for hand, arm in _ARMS.items()),
    Command(COMMAND, String, MessageClass.COMMAND, "controller"),
)


class LinkMessageType(IntEnum):
    """First byte of a message; then a number (4) and a content."""

    TOPIC = 0  # to the robot: index in COMMANDS, message
    GOAL = 1  # to the robot: index in ACTIONS, goal
    CANCEL = 2  # to the robot: link id of the goal
    ACCEPTED = 3  # from the robot: link id of an accepted goal or published message
    REFUSED = 4  # from the robot: link id of a rejected command, reason
    RESULT = 5  # from the robot: link id of the goal, status, result
    REJECTION = 6  # from the robot: 0, valor_msgs/Rejection of any client's command
    STEPS = 7  # from the robot: 0, steps of the active plan
    PROGRESS = 8  # from the robot: link id of the plan's goal (0: of another client), feedback
    HAND = 9  # from the robot: index in HANDS, status of its goal
    CONTROLLERS = 10  # from the robot: 0, valor_msgs/ControllerStatus


def class_of(command: Command, message: Any) -> MessageClass:
    """Class of a message; a mode command that requests the emergency stop is a stop."""
    requested = getattr(message, "requested_control_mode", "")
    return MessageClass.STOP if requested.strip().lower() == EMERGENCY_STOP else command.kind


class MessageCodec:
    """Encodes ROS messages."""

    def __init__(self, robot: RobotDescription) -> None:
        names = (*robot.joints, *robot.tables.link_frames, *ControlMode, "odom", "base_link", "pelvis", "support")
        self._dictionary = b"".join((len(name) + 1).to_bytes(4, "little") + name.encode() + b"\0" for name in names)

    def pack(self, message: Any) -> bytes:
        if not isinstance(message, ExecuteStepPlan.Goal):
            return self._deflate(message)
        steps = packed_steps.pack(message.step_plan.steps)
        if steps is None:
            return _UNPACKED + self._deflate(message)
        bare = ExecuteStepPlan.Goal(step_plan=copy.copy(message.step_plan))
        bare.step_plan.steps = []
        rest = self._deflate(bare)
        return len(rest).to_bytes(2, "big") + rest + steps

    def _deflate(self, message: Any) -> bytes:
        deflate = zlib.compressobj(9, zlib.DEFLATED, -15, 9, zlib.Z_DEFAULT_STRATEGY, self._dictionary)
        return deflate.compress(serialize_message(message)) + deflate.flush()

    def unpack(self, data: bytes, kind: Any) -> Any:
        """Inverse of ``pack``; ``kind``: type of the message. Raises SealError: not a message of this type."""
        if kind is not ExecuteStepPlan.Goal:
            return self._inflate(data, kind)
        size = int.from_bytes(data[:2], "big")
        goal = self._inflate(data[2 : 2 + size] if size else data[2:], kind)
        if size:
            goal.step_plan.steps = packed_steps.unpack(data[2 + size :])
        return goal

    def _inflate(self, data: bytes, kind: Any) -> Any:
        inflate = zlib.decompressobj(-15, self._dictionary)
        try:
            return deserialize_message(inflate.decompress(data, 1 << 20), kind)
        except Exception as error:  # of zlib and rclpy
            raise SealError(f"{kind.__name__}: {' '.join(str(error).split())}") from None


def pack_message(type_: LinkMessageType, number: int, content: bytes = b"") -> bytes:
    """Message of the link."""
    return bytes((type_,)) + number.to_bytes(4, "big") + content


def unpack_message(data: bytes) -> tuple[LinkMessageType, int, bytes]:
    """Type, number and content. Raises SealError: too short, or of an unknown type."""
    try:
        type_ = LinkMessageType(data[0])
    except (IndexError, ValueError):
        raise SealError("message of an unknown type") from None
    if len(data) < 5:
        raise SealError(f"{type_.name}: {len(data)} bytes; expected at least 5")
    return type_, int.from_bytes(data[1:5], "big"), data[5:]
