"""Every Bifrost topic: name, type, who publishes it, how often, and how the bag recorder keeps it.

One of the two tables a newcomer opens first (the other is ``processes.py``). Add a line here to add a topic: who
publishes and who subscribes does so by it (``MOTOR.publisher(node)``, ``MOTOR.subscriber(node)``); the recorder, the
grants of the keys and the tables in the documentation come from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import bifrost
from bifrost import Message
from valor.common import messages as m
from valor.common.errors import ConfigurationError
from valor.common.floods import COMMANDS, REQUESTS, STREAM
from valor.common.processes import DAEMON, PROCESSES

PAUSED = "paused"  # ClockStatus.mode of a simulation whose time stands
CONTROL_RATE = 0.0  # stands for the robot's control rate in the ``rate`` column

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Message)
R = TypeVar("R", bound=Message)


@dataclass(frozen=True)
class Topic(Generic[M]):
    """One line of the table."""

    name: str
    type: type[M]
    owner: str  # the process that publishes it
    rate: float | None  # nominal [Hz]; CONTROL_RATE: every control period; None: on change or on demand
    record_every: int  # the recorder keeps every n-th message; 0: none
    description: str
    others: tuple[str, ...] = ()  # who may publish it, too: in the owner's place, or as one who commands
    queue: int | None = None  # messages that wait for a subscriber, where each counts; None: the newest alone counts
    latched: bool = False  # who subscribes later is told the last message, too

    @property
    def publishers(self) -> tuple[str, ...]:
        """All who may publish it, and nobody else."""
        return (self.owner, *self.others)

    @property
    def limit(self) -> bifrost.Limit:
        """What no publisher may exceed."""
        return STREAM if self.rate == CONTROL_RATE else COMMANDS

    def publisher(self, node: bifrost.Node) -> bifrost.Publisher[M]:
        """Publish on it; errors as of ``Node.publisher``."""
        return node.publisher(self.name, self.type, latched=self.latched)

    def subscriber(
        self, node: bifrost.Node, queue: int | None = None, *, limited: bool = True
    ) -> bifrost.Subscriber[M]:
        """Subscribe to it.

        Args:
            node: to subscribe with.
            queue: of another length than the table's.
            limited: whether a publisher that floods it is muted.
        """
        return node.subscriber(self.name, self.type, queue=queue or self.queue, limit=self.limit if limited else None)


@dataclass(frozen=True)
class ServiceTopic(Generic[Q, R]):
    """A request–reply topic."""

    name: str
    request: type[Q]
    reply: type[R]
    owner: str  # the process that serves it
    description: str
    others: tuple[str, ...] = ()  # who may serve it, too: in the owner's place

    @property
    def servers(self) -> tuple[str, ...]:
        """All who may serve it, and nobody else."""
        return (self.owner, *self.others)

    def server(self, node: bifrost.Node, handler: Callable[[Q, str], R]) -> bifrost.Server[Q, R]:
        """Serve it; ``handler`` and errors as of ``Node.server``."""
        return node.server(self.name, self.request, self.reply, handler, REQUESTS)

    def client(self, node: bifrost.Node) -> bifrost.Client[Q, R]:
        """Call its server."""
        return node.client(self.name, self.request, self.reply)


_COMMS, _MOTION, _VRC = "comms_manager", "motion_manager", "valor_ros_controller"
_RECORDER, _EMULATORS, _HDT_BRIDGE = "bag_recorder", "device_emulators", "hdt_bridge"

VALORCTL = "valorctl"
"""Whoever drives an instance by its command line: no process of it, but with a key of its own."""

# fmt: off
#                       name                                 type                 owner    rate       record, description
PROPRIOCEPTOR   = Topic("comms_manager/proprioceptor",       m.Proprioceptor,     _COMMS,  CONTROL_RATE, 1, "what the devices measured")
CLOCK           = Topic("comms_manager/clock",               m.ClockStatus,       _COMMS,  10.0,         1, "robot time against the wall's", latched=True)
MOTOR           = Topic("motion_manager/motor",              m.Motor,             _MOTION, CONTROL_RATE, 1, "commands to the motors")
MOTION_STATE    = Topic("motion_manager/motion_state",       m.MotionState,       _MOTION, CONTROL_RATE, 1, "behavior, estimate, balance")
BEHAVIOR_CHANGE = Topic("motion_manager/behavior_change",    m.BehaviorChange,    _MOTION, None,         0, "the behavior, and why, as it changed last", latched=True)
REJECTION       = Topic("motion_manager/rejection",          m.Rejection,         _MOTION, None,         1, "commands not obeyed, and why")
STEP_STATUS     = Topic("motion_manager/step_status",        m.StepStatus,        _MOTION, 10.0,         1, "progress of a footstep plan")
JOINT_SETPOINTS = Topic("motion_manager/joint_setpoints",    m.JointSetpoints,    _VRC,    None,         1, "set-points by joint name", queue=16)
VELOCITY        = Topic("motion_manager/velocity",           m.VelocityCommand,   _VRC,    None,         1, "walking velocity; times out", (VALORCTL,), queue=4)
PELVIS          = Topic("motion_manager/pelvis",             m.PelvisSetpoint,    _VRC,    None,         1, "where the pelvis shall be", queue=16)
HAND_GOAL       = Topic("motion_manager/hand_goal",          m.HandGoal,          _VRC,    None,         1, "where a hand shall be", queue=4)
HAND_GOAL_STATUS = Topic("motion_manager/hand_goal_status",  m.HandGoalStatus,    _MOTION, None,         1, "progress of a hand towards its goal")
JOINT_GAINS     = Topic("motion_manager/joint_gains",        m.JointGains,        _VRC,    None,         1, "stiffness and damping", queue=4)
BALANCE_WEIGHTS = Topic("motion_manager/balance_weights",    m.BalanceWeights,    _VRC,    None,         1, "weights of the tasks", queue=4)
DEVICES         = Topic("comms_manager/devices",             m.DeviceStatus,      _COMMS,  None,         1, "state of every device; hardware only")
CONTROL_MODE    = Topic("valor_ros_controller/control_mode", m.ControlModeReport, _VRC,    10.0,         1, "the VRC's control mode", latched=True)
CYCLE           = Topic("valor_ros_controller/cycle",        m.ControllerCycle,   _VRC,    None,         0, "a cycle of the VRC is done")
GROUND_TRUTH    = Topic("simulation/ground_truth",           m.GroundTruth,       _COMMS,  100.0,        1, "the simulator's truth; no controller may read it", (_EMULATORS,))

HDT_COMMANDS = {
    limb: Topic(f"comms_manager/hdt/{limb}/command", m.HdtCommand, _COMMS, None, 1, "joint impedance of an HDT limb; hardware only")
    for limb in ("left_arm", "right_arm", "left_hand", "right_hand")
}
HDT_STATES = {
    limb: Topic(f"comms_manager/hdt/{limb}/state", m.HdtState, _HDT_BRIDGE, None, 1, "what an HDT limb's driver says; hardware only")
    for limb in HDT_COMMANDS
}
STATISTICS = {
    process.name: Topic(f"{process.name}/statistics", m.Statistics, process.name, 1.0, 1, "state of a process", process.spokesmen, latched=True)
    for process in PROCESSES if process.name != DAEMON
}

TOPICS: tuple[Topic[Any], ...] = (
    *(row for row in list(globals().values()) if isinstance(row, Topic)),
    *HDT_COMMANDS.values(), *HDT_STATES.values(), *STATISTICS.values(),
)

#                            name                            request                reply                owner    description
BEHAVIOR      = ServiceTopic("motion_manager/behavior",      m.BehaviorRequest,     m.BehaviorReply,     _MOTION, "go to a behavior")
STOP          = ServiceTopic("comms_manager/stop",           m.BehaviorRequest,     m.BehaviorReply,     _COMMS,  "fall, soft_stop or freeze, while no Motion Manager leads the robot")
FOOTSTEP_PLAN = ServiceTopic("motion_manager/footstep_plan", m.FootstepPlanRequest, m.FootstepPlanReply, _MOTION, "execute, update or stop a footstep plan")
PUSH          = ServiceTopic("simulation/push",              m.PushRequest,         m.PushReply,         _COMMS,  "push a body of the robot; simulation only", (_EMULATORS,))
SIMULATED_TIME = ServiceTopic("simulation/time",             m.TimeRequest,         m.TimeReply,         _COMMS,  "pause, step, slow down; simulation without devices only")
FAULT         = ServiceTopic("simulation/fault",             m.FaultRequest,        m.FaultReply,        _EMULATORS, "let an emulated device fail; hardware without a robot only")
SNAP          = ServiceTopic("bag_recorder/snap",            m.SnapRequest,         m.SnapReply,         _RECORDER, "save the last seconds that the recorder holds")
BEYOND        = ServiceTopic("link_operator/beyond",         m.BeyondRequest,       m.BeyondReply,       "link_operator", "do a verb of valorctl on the robot's side of the link, or say how one fares")
MARK          = ServiceTopic("bag_recorder/mark",            m.MarkRequest,         m.MarkReply,         _RECORDER, "note a moment in the recording, with a text")
# fmt: on

SERVICE_TOPICS: tuple[ServiceTopic[Any, Any], ...] = tuple(
    row for row in list(globals().values()) if isinstance(row, ServiceTopic)
)


def hdt_topics(limb: str) -> tuple[Topic[m.HdtCommand], Topic[m.HdtState]]:
    """The two topics of an HDT limb, named as in robot.yaml.

    Raises:
        ConfigurationError: it has none.
    """
    if limb not in HDT_COMMANDS:
        raise ConfigurationError(
            f"robot.yaml: devices: limb {limb!r} has no Bifrost topics; expected one of {', '.join(HDT_COMMANDS)}"
        )
    return HDT_COMMANDS[limb], HDT_STATES[limb]
