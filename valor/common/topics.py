"""Every Bifrost topic: name, type, publisher, nominal rate, and how the bag recorder keeps it.

One of the two tables a newcomer opens first (the other is ``processes.py``). Add a line here to add a topic:
the recorder, ``valorctl topic`` and the tables in the documentation come from it.
"""

from __future__ import annotations

from dataclasses import dataclass

from bifrost import Message
from valor.common import messages as m

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
    others: tuple[str, ...] = ()  # who may publish it, too: in the publisher's place, or as one who commands

    @property
    def publishers(self) -> tuple[str, ...]:
        """All who may publish it, and nobody else."""
        return (self.publisher, *self.others)


@dataclass(frozen=True)
class ServiceTopic:
    """A request–reply topic."""

    name: str
    request: type[Message]
    reply: type[Message]
    server: str
    description: str
    others: tuple[str, ...] = ()  # who may serve it, too: in the server's place

    @property
    def servers(self) -> tuple[str, ...]:
        """All who may serve it, and nobody else."""
        return (self.server, *self.others)


_COMMS, _MOTION, _VRC = "comms_manager", "motion_manager", "valor_ros_controller"
_CONVERTER, _RECORDER, _EMULATORS = "footstep_converter", "bag_recorder", "device_emulators"
_HDT_DRIVER, _HDT_BRIDGE = "hdt_driver", "hdt_bridge"

VALORCTL = "valorctl"
"""Whoever drives an instance by its command line: no process of it, but with a key of its own."""

# fmt: off
#                                     name                                 type                publisher   rate          record, description
PROPRIOCEPTOR                 = Topic("comms_manager/proprioceptor",       m.Proprioceptor,    _COMMS,     CONTROL_RATE, 1, "what the devices measured")
CLOCK                         = Topic("comms_manager/clock",               m.ClockStatus,      _COMMS,     10.0,         1, "robot time against the wall's")
MOTOR                         = Topic("motion_manager/motor",              m.Motor,            _MOTION,    CONTROL_RATE, 1, "commands to the motors")
MOTION_STATE                  = Topic("motion_manager/motion_state",       m.MotionState,      _MOTION,    CONTROL_RATE, 1, "behavior, estimate, balance")
BEHAVIOR_CHANGE               = Topic("motion_manager/behavior_change",    m.BehaviorChange,   _MOTION,    None,         0, "the behavior, and why, as it changed last; latched")
REJECTION                     = Topic("motion_manager/rejection",          m.Rejection,        _MOTION,    None,         1, "commands not obeyed, and why")
STEP_STATUS                   = Topic("motion_manager/step_status",        m.StepStatus,       _MOTION,    10.0,         1, "progress of a footstep plan")
JOINT_SETPOINTS               = Topic("motion_manager/joint_setpoints",    m.JointSetpoints,   _VRC,       250.0,        1, "set-points by joint name")
VELOCITY                      = Topic("motion_manager/velocity",           m.VelocityCommand,  _VRC,       None,         1, "walking velocity; times out", (VALORCTL,))
PELVIS                        = Topic("motion_manager/pelvis",             m.PelvisSetpoint,   _VRC,       250.0,        1, "where the pelvis shall be")
HAND_GOAL                     = Topic("motion_manager/hand_goal",          m.HandGoal,         _VRC,       None,         1, "where a hand shall be")
HAND_GOAL_STATUS              = Topic("motion_manager/hand_goal_status",   m.HandGoalStatus,   _MOTION,    None,         1, "how a hand fares on its way")
JOINT_GAINS                   = Topic("motion_manager/joint_gains",        m.JointGains,       _VRC,       None,         1, "stiffness and damping")
BALANCE_WEIGHTS               = Topic("motion_manager/balance_weights",    m.BalanceWeights,   _VRC,       None,         1, "weights of the tasks")
DEVICES                       = Topic("comms_manager/devices",             m.DeviceStatus,    _COMMS,    None,         1, "how the devices fare; hardware only")
HDT_LEFT_ARM_COMMAND          = Topic("comms_manager/hdt/left_arm/command",  m.HdtCommand,    _COMMS,    None,         0, "joint impedance of the arm; hardware only")
HDT_RIGHT_ARM_COMMAND         = Topic("comms_manager/hdt/right_arm/command", m.HdtCommand,    _COMMS,    None,         0, "likewise")
HDT_LEFT_HAND_COMMAND         = Topic("comms_manager/hdt/left_hand/command", m.HdtCommand,    _COMMS,    None,         0, "joint impedance of the hand; hardware only")
HDT_RIGHT_HAND_COMMAND        = Topic("comms_manager/hdt/right_hand/command", m.HdtCommand,   _COMMS,    None,         0, "likewise")
HDT_LEFT_ARM_STATE            = Topic("comms_manager/hdt/left_arm/state",  m.HdtState,        _HDT_BRIDGE,    None,         0, "what the arm's driver says; hardware only")
HDT_RIGHT_ARM_STATE           = Topic("comms_manager/hdt/right_arm/state", m.HdtState,        _HDT_BRIDGE,    None,         0, "likewise")
HDT_LEFT_HAND_STATE           = Topic("comms_manager/hdt/left_hand/state", m.HdtState,        _HDT_BRIDGE,    None,         0, "what the hand's driver says; hardware only")
HDT_RIGHT_HAND_STATE          = Topic("comms_manager/hdt/right_hand/state", m.HdtState,       _HDT_BRIDGE,    None,         0, "likewise")
CONTROL_MODE                  = Topic("valor_ros_controller/control_mode", m.ControlModeReport, _VRC,      10.0,         1, "the VRC's control mode")
GROUND_TRUTH                  = Topic("simulation/ground_truth",           m.GroundTruth,      _COMMS,     100.0,        1, "the simulator's truth; no controller may read it", (_EMULATORS,))
MOTION_MANAGER_STATISTICS     = Topic("motion_manager/statistics",         m.Statistics,       _MOTION,    1.0,          1, "how it fares")
COMMS_MANAGER_STATISTICS      = Topic("comms_manager/statistics",          m.Statistics,       _COMMS,     1.0,          1, "how it fares")
VALOR_ROS_CONTROLLER_STATISTICS = Topic("valor_ros_controller/statistics", m.Statistics,       _VRC,       1.0,          1, "how it fares")
DEVICE_EMULATORS_STATISTICS   = Topic("device_emulators/statistics",       m.Statistics,       _EMULATORS, 1.0,          1, "how they fare; hardware without a robot only")
HDT_DRIVER_STATISTICS         = Topic("hdt_driver/statistics",             m.Statistics,       _HDT_DRIVER, 1.0,         1, "how it fares: the bridge's word for the driver, from /diagnostics", (_HDT_BRIDGE,))
HDT_BRIDGE_STATISTICS         = Topic("hdt_bridge/statistics",             m.Statistics,       _HDT_BRIDGE, 1.0,         1, "how it fares")
FOOTSTEP_CONVERTER_STATISTICS = Topic("footstep_converter/statistics",     m.Statistics,       _CONVERTER, 1.0,          1, "how it fares")
BAG_RECORDER_STATISTICS       = Topic("bag_recorder/statistics",           m.Statistics,       _RECORDER,  1.0,          1, "how it fares")

TOPICS: tuple[Topic, ...] = (
    PROPRIOCEPTOR, CLOCK, MOTOR, MOTION_STATE, BEHAVIOR_CHANGE, REJECTION, STEP_STATUS, JOINT_SETPOINTS, VELOCITY, PELVIS,
    HAND_GOAL, HAND_GOAL_STATUS, JOINT_GAINS, BALANCE_WEIGHTS, DEVICES,
    HDT_LEFT_ARM_COMMAND, HDT_RIGHT_ARM_COMMAND, HDT_LEFT_HAND_COMMAND, HDT_RIGHT_HAND_COMMAND,
    HDT_LEFT_ARM_STATE, HDT_RIGHT_ARM_STATE, HDT_LEFT_HAND_STATE, HDT_RIGHT_HAND_STATE, CONTROL_MODE,
    GROUND_TRUTH, MOTION_MANAGER_STATISTICS, COMMS_MANAGER_STATISTICS, VALOR_ROS_CONTROLLER_STATISTICS,
    DEVICE_EMULATORS_STATISTICS, HDT_DRIVER_STATISTICS, HDT_BRIDGE_STATISTICS, FOOTSTEP_CONVERTER_STATISTICS, BAG_RECORDER_STATISTICS,
)

#                            name                            request                reply                server    description
BEHAVIOR      = ServiceTopic("motion_manager/behavior",      m.BehaviorRequest,      m.BehaviorReply,      _MOTION, "go to a behavior")
STOP          = ServiceTopic("comms_manager/stop",           m.BehaviorRequest,      m.BehaviorReply,      _COMMS,  "fall, soft_stop or freeze, while no Motion Manager leads the robot")
FOOTSTEP_PLAN = ServiceTopic("motion_manager/footstep_plan", m.FootstepPlanRequest,  m.FootstepPlanReply,  _MOTION, "execute, update or stop a footstep plan")
PUSH          = ServiceTopic("simulation/push",              m.PushRequest,          m.PushReply,          _COMMS,  "push the chest; simulation only", (_EMULATORS,))
FAULT         = ServiceTopic("simulation/fault",             m.FaultRequest,         m.FaultReply,         _EMULATORS, "let an emulated device fail; hardware without a robot only")
SNAP          = ServiceTopic("bag_recorder/snap",            m.SnapRequest,          m.SnapReply,          _RECORDER, "save the last seconds that the recorder holds")
# fmt: on

SERVICE_TOPICS: tuple[ServiceTopic, ...] = (BEHAVIOR, STOP, FOOTSTEP_PLAN, PUSH, FAULT, SNAP)

STATISTICS: dict[str, Topic] = {topic.publisher: topic for topic in TOPICS if topic.type is m.Statistics}
