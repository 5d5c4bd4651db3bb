"""Every Bifrost topic: name, type, publisher, nominal rate, and how the bag recorder keeps it.

One of the two tables a newcomer opens first (the other is ``processes.py``). Add a line here to add a topic: the
recorder, ``valorctl topic`` and the tables in the documentation come from it.
"""

from __future__ import annotations

from dataclasses import dataclass

from bifrost import Message
from valor_common import messages as m

CONTROL_RATE = 0.0  # stands for the robot's control rate in the ``rate`` column


@dataclass(frozen=True)
class Topic:
    """One line of the table."""

    name: str
    type: type[Message]
    publisher: str  # the process that publishes it
    rate: float | None  # nominal [Hz]; CONTROL_RATE: every control period; None: on change or on demand
    record_every: int  # the recorder keeps every n-th message; 0: none
    description: str


@dataclass(frozen=True)
class ServiceTopic:
    """A request–reply topic."""

    name: str
    request: type[Message]
    reply: type[Message]
    server: str
    description: str


PROPRIOCEPTOR = Topic(
    "comms_manager/proprioceptor",
    m.Proprioceptor,
    "comms_manager",
    CONTROL_RATE,
    1,
    "what the devices measured",
)
CLOCK = Topic("comms_manager/clock", m.ClockStatus, "comms_manager", 10.0, 1, "robot time against the wall's")
MOTOR = Topic("motion_manager/motor", m.Motor, "motion_manager", CONTROL_RATE, 1, "commands to the motors")
MOTION_STATE = Topic(
    "motion_manager/motion_state",
    m.MotionState,
    "motion_manager",
    CONTROL_RATE,
    1,
    "behavior, estimate, balance",
)
REJECTION = Topic(
    "motion_manager/rejection", m.Rejection, "motion_manager", None, 1, "commands not obeyed, and why"
)
STEP_STATUS = Topic(
    "motion_manager/step_status", m.StepStatus, "motion_manager", 10.0, 1, "progress of a footstep plan"
)
JOINT_SETPOINTS = Topic(
    "motion_manager/joint_setpoints",
    m.JointSetpoints,
    "valor_ros_controller",
    250.0,
    1,
    "set-points by joint name",
)
CONTROL_MODE = Topic(
    "valor_ros_controller/control_mode",
    m.ControlModeReport,
    "valor_ros_controller",
    10.0,
    1,
    "the VRC's control mode",
)
GROUND_TRUTH = Topic(
    "simulation/ground_truth",
    m.GroundTruth,
    "comms_manager",
    100.0,
    1,
    "the simulator's truth; no controller may read it",
)
MOTION_MANAGER_STATISTICS = Topic(
    "motion_manager/statistics", m.Statistics, "motion_manager", 1.0, 1, "how it fares"
)
COMMS_MANAGER_STATISTICS = Topic(
    "comms_manager/statistics", m.Statistics, "comms_manager", 1.0, 1, "how it fares"
)
VALOR_ROS_CONTROLLER_STATISTICS = Topic(
    "valor_ros_controller/statistics", m.Statistics, "valor_ros_controller", 1.0, 1, "how it fares"
)
FOOTSTEP_CONVERTER_STATISTICS = Topic(
    "footstep_converter/statistics", m.Statistics, "footstep_converter", 1.0, 1, "how it fares"
)
BAG_RECORDER_STATISTICS = Topic(
    "bag_recorder/statistics", m.Statistics, "bag_recorder", 1.0, 1, "how it fares"
)

TOPICS: tuple[Topic, ...] = (
    PROPRIOCEPTOR, CLOCK, MOTOR, MOTION_STATE, REJECTION, STEP_STATUS, JOINT_SETPOINTS, CONTROL_MODE, GROUND_TRUTH,
    MOTION_MANAGER_STATISTICS, COMMS_MANAGER_STATISTICS, VALOR_ROS_CONTROLLER_STATISTICS,
    FOOTSTEP_CONVERTER_STATISTICS, BAG_RECORDER_STATISTICS,
)  # fmt: skip

BEHAVIOR = ServiceTopic(
    "motion_manager/behavior", m.BehaviorRequest, m.BehaviorReply, "motion_manager", "go to a behavior"
)
FOOTSTEP_PLAN = ServiceTopic(
    "motion_manager/footstep_plan",
    m.FootstepPlanRequest,
    m.FootstepPlanReply,
    "motion_manager",
    "execute, update or stop a footstep plan",
)
PUSH = ServiceTopic(
    "simulation/push", m.PushRequest, m.PushReply, "comms_manager", "push the chest; simulation only"
)

SERVICE_TOPICS: tuple[ServiceTopic, ...] = (BEHAVIOR, FOOTSTEP_PLAN, PUSH)

STATISTICS: dict[str, Topic] = {topic.publisher: topic for topic in TOPICS if topic.type is m.Statistics}
