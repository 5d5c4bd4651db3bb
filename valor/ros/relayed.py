"""What goes from the operator's ROS network to the robot's, over the link: one table for both ends, and its words.

A message travels serialized (CDR) and deflated with a dictionary of the robot's names, which both ends have; a plan's
steps travel packed.
"""

from __future__ import annotations

import copy
import zlib
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from control_msgs.action import FollowJointTrajectory
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Empty
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_humanoid_control_msgs.action import ChangeControlMode
from vigir_humanoid_control_msgs.msg import VigirControlModeCommand

from valor.common.behaviors import EMERGENCY_STOP, ControlMode
from valor.link.classes import Kind
from valor.link.errors import SealError
from valor.robot.description import RobotDescription
from valor.ros import packed_steps
from valor.ros.limbs import HANDS

_WHOLE = b"\0\0"  # in front of a plan whose steps are not packed
_TRAJECTORY = "trajectory_controllers/{}_traj_controller/follow_joint_trajectory"
_GROUPS = ("left_arm", "right_arm", "torso", "left_hand", "right_hand", "neck", "pelvis")


@dataclass(frozen=True)
class Action:
    """One line: an action that both ends offer, one as server and one as client."""

    name: str
    type: Any


@dataclass(frozen=True)
class Command:
    """One line: a topic that the operator's end hears and the robot's publishes."""

    name: str
    type: Any
    kind: Kind


ACTIONS: tuple[Action, ...] = (
    Action("mode_controllers/control_mode_controller/change_control_mode", ChangeControlMode),
    Action("robot_controllers/footstep_controller/execute_step_plan", ExecuteStepPlan),
    *(Action(_TRAJECTORY.format(group), FollowJointTrajectory) for group in _GROUPS),
)
COMMANDS: tuple[Command, ...] = (
    Command("flor/controller/soft_stop", Empty, Kind.STOP),
    Command("flor/controller/mode_command", VigirControlModeCommand, Kind.COMMAND),
    Command("cmd_vel", Twist, Kind.STREAM),
    Command("flor/pelvis_controller/goal_pose", PoseStamped, Kind.COMMAND),
    *(Command(f"flor/{hand}/goal_pose", PoseStamped, Kind.COMMAND) for hand in HANDS),
    *(Command(f"flor/{hand}/goal_cancel", Empty, Kind.COMMAND) for hand in HANDS),
)


class Word(IntEnum):
    """What a message on the link is about; the first byte of it."""

    TOPIC = 0  # to the robot: place in COMMANDS, message
    GOAL = 1  # to the robot: place in ACTIONS, goal; its id is the link's
    CANCEL = 2  # to the robot: id of the goal
    ACCEPTED = 3  # from it: id of the goal that is begun, or of the message that is published
    REFUSED = 4  # from it: id of what was not done, why
    RESULT = 5  # from it: id of the goal, status, result
    TOLD = 6  # from it: 0, a line of text
    STEPS = 7  # from it: 0, the steps of the plan that runs
    PROGRESS = 8  # from it: id of the plan's goal, 0 of another's; how it fares
    HAND = 9  # from it: place in HANDS, how its goal fares
    VERB = 10  # to the robot: 0, a verb of valorctl with its arguments (valor/link/verbs.py)
    SAID = 11  # from it: id of the verb, what was said to it


def kind_of(command: Command, message: Any) -> Kind:
    """How urgent a message is; an emergency stop by the name of a mode is a stop."""
    asked = getattr(message, "requested_control_mode", "")
    return Kind.STOP if asked.strip().lower() == EMERGENCY_STOP else command.kind


class Deflated:
    """Messages as bytes and back."""

    def __init__(self, robot: RobotDescription) -> None:
        names = (*robot.joints, *robot.tables.link_frames, *ControlMode, "odom", "base_link", "pelvis", "support")
        self._dictionary = b"".join((len(name) + 1).to_bytes(4, "little") + name.encode() + b"\0" for name in names)

    def pack(self, message: Any) -> bytes:
        """As it travels."""
        if not isinstance(message, ExecuteStepPlan.Goal):
            return self._deflate(message)
        steps = packed_steps.pack(message.step_plan.steps)
        if steps is None:
            return _WHOLE + self._deflate(message)
        bare = ExecuteStepPlan.Goal(step_plan=copy.copy(message.step_plan))
        bare.step_plan.steps = []
        rest = self._deflate(bare)
        return len(rest).to_bytes(2, "big") + rest + steps

    def _deflate(self, message: Any) -> bytes:
        deflate = zlib.compressobj(9, zlib.DEFLATED, -15, 9, zlib.Z_DEFAULT_STRATEGY, self._dictionary)
        return deflate.compress(serialize_message(message)) + deflate.flush()

    def unpack(self, data: bytes, kind: Any) -> Any:
        """The message.

        Raises:
            SealError: it is none of this type.
        """
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
        except Exception as error:  # zlib's, and whatever rclpy raises
            raise SealError(f"no {kind.__name__}: {' '.join(str(error).split())}") from None


def worded(word: Word, number: int, content: bytes = b"") -> bytes:
    """A message of the link: its word, a number, the rest."""
    return bytes((word,)) + number.to_bytes(4, "big") + content


def read(data: bytes) -> tuple[Word, int, bytes]:
    """The word, its number and the rest.

    Raises:
        SealError: it is too short, or of no known word.
    """
    try:
        word = Word(data[0])
    except (IndexError, ValueError):
        raise SealError("a message without a known word") from None
    if len(data) < 5:
        raise SealError(f"{word.name}: {len(data)} bytes; expected at least 5")
    return word, int.from_bytes(data[1:5], "big"), data[5:]
