"""The Bifrost topics and services: name, type, publishers, rate, recording; and access to the network.

To add a topic, add a line here. Its publishers and subscribers (``MOTOR.publisher(node)``), the recorder, the grants of
the keys and the tables in the documentation follow from it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import bifrost
from bifrost import Message
from bifrost.network import own_key_file
from valor.common import messages as m
from valor.common.errors import ConfigurationError
from valor.common.instance import Instance
from valor.common.processes import DAEMON, PROCESSES

PAUSED = "paused"  # ClockStatus.mode of a simulation with paused time
CONTROL_RATE = 0.0  # in the ``rate`` column: the robot's control rate

STREAM = bifrost.Limit(rate=10_000.0, burst=2_000)
"""Limit of topics with a message every control period; allows for robots simulated faster than real time."""
COMMANDS = bifrost.Limit(rate=2_000.0, burst=500)
"""Limit of set-points, velocities and goals, four times the rate of the fastest regular sender, the VRC."""
REQUESTS = bifrost.Limit(rate=100.0, burst=100)
"""Limit of requests; operators and plans send a few per second."""

M = TypeVar("M", bound=Message)
Q = TypeVar("Q", bound=Message)
R = TypeVar("R", bound=Message)


@dataclass(frozen=True)
class Topic(Generic[M]):
    """One line of the table."""

    name: str
    type: type[M]
    owner: str  # publishing process
    rate: float | None  # nominal [Hz]; CONTROL_RATE: every control period; None: on change or on demand
    record_every: int  # the recorder keeps every n-th message; 0: none
    description: str
    others: tuple[str, ...] = ()  # other permitted publishers
    queue: int | None = None  # length of the subscribers' queue; None: the latest message only
    latched: bool = False  # later subscribers get the last message

    @property
    def publishers(self) -> tuple[str, ...]:
        """All permitted publishers."""
        return (self.owner, *self.others)

    @property
    def limit(self) -> bifrost.Limit:
        """Maximum rate of each publisher."""
        return STREAM if self.rate == CONTROL_RATE else COMMANDS

    def publisher(self, node: bifrost.Node) -> bifrost.Publisher[M]:
        """Publish on it; errors as of ``Node.publisher``."""
        return node.publisher(self.name, self.type, latched=self.latched)

    def subscriber(
        self, node: bifrost.Node, queue: int | None = None, *, limited: bool = True
    ) -> bifrost.Subscriber[M]:
        """Subscribe to it, with another queue than the table's, or without muting publishers that exceed the limit."""
        return node.subscriber(self.name, self.type, queue=queue or self.queue, limit=self.limit if limited else None)


@dataclass(frozen=True)
class ServiceTopic(Generic[Q, R]):
    """A request–reply topic."""

    name: str
    request: type[Q]
    reply: type[R]
    owner: str  # serving process
    description: str
    others: tuple[str, ...] = ()  # other permitted servers

    @property
    def servers(self) -> tuple[str, ...]:
        """All permitted servers."""
        return (self.owner, *self.others)

    def server(self, node: bifrost.Node, handler: Callable[[Q, str], R]) -> bifrost.Server[Q, R]:
        """Serve it; ``handler`` and errors as of ``Node.server``."""
        return node.server(self.name, self.request, self.reply, handler, REQUESTS)

    def client(self, node: bifrost.Node) -> bifrost.Client[Q, R]:
        """Call its server."""
        return node.client(self.name, self.request, self.reply)


_COMMS, _MOTION, _VRC = "comms_manager", "motion_manager", "valor_ros_controller"
_RECORDER, _EMULATORS, _HDT_BRIDGE = "bag_recorder", "device_emulators", "hdt_bridge"

# fmt: off
#                       name                                 type                 owner    rate       record, description
PROPRIOCEPTOR   = Topic("comms_manager/proprioceptor",       m.Proprioceptor,     _COMMS,  CONTROL_RATE, 1, "measurements of the devices")
CLOCK           = Topic("comms_manager/clock",               m.ClockStatus,       _COMMS,  10.0,         1, "robot time and wall time", latched=True)
MOTOR           = Topic("motion_manager/motor",              m.Motor,             _MOTION, CONTROL_RATE, 1, "commands to the motors")
MOTION_STATE    = Topic("motion_manager/motion_state",       m.MotionState,       _MOTION, CONTROL_RATE, 1, "behavior, estimate, balance")
BEHAVIOR_CHANGE = Topic("motion_manager/behavior_change",    m.BehaviorChange,    _MOTION, None,         0, "last change of behavior, with the reason", latched=True)
FROZEN          = Topic("motion_manager/frozen",             m.FrozenLimbs,       _MOTION, None,         1, "limbs that hold while the rest moves", latched=True)
CONTROLLERS     = Topic("motion_manager/controllers",        m.ControllerStatus,  _MOTION, None,         1, "controllers of the balancing robot, and which is in control", latched=True)
REJECTION       = Topic("motion_manager/rejection",          m.Rejection,         _MOTION, None,         1, "rejected commands, with the reason")
STEP_STATUS     = Topic("motion_manager/step_status",        m.StepStatus,        _MOTION, 10.0,         1, "progress of a footstep plan")
JOINT_SETPOINTS = Topic("motion_manager/joint_setpoints",    m.JointSetpoints,    _VRC,    None,         1, "set-points by joint name", queue=16)
JOINT_COMMANDS  = Topic("motion_manager/joint_commands",     m.JointCommands,     _VRC,    None,         1, "commands of a balance controller outside the Motion System", queue=4)
VELOCITY        = Topic("motion_manager/velocity",           m.VelocityCommand,   _VRC,    None,         1, "walking velocity; times out", queue=4)
PELVIS          = Topic("motion_manager/pelvis",             m.PelvisSetpoint,    _VRC,    None,         1, "desired pose of the pelvis", queue=16)
HAND_GOAL       = Topic("motion_manager/hand_goal",          m.HandGoal,          _VRC,    None,         1, "desired pose of a hand", queue=4)
HAND_GOAL_STATUS = Topic("motion_manager/hand_goal_status",  m.HandGoalStatus,    _MOTION, None,         1, "progress of a hand towards its goal")
JOINT_GAINS     = Topic("motion_manager/joint_gains",        m.JointGains,        _VRC,    None,         1, "stiffness and damping", queue=4)
BALANCE_WEIGHTS = Topic("motion_manager/balance_weights",    m.BalanceWeights,    _VRC,    None,         1, "weights of the tasks", queue=4)
DEVICES         = Topic("comms_manager/devices",             m.DeviceStatus,      _COMMS,  None,         1, "state of every device: hardware and batteries")
BATTERIES       = Topic("comms_manager/batteries",           m.BatteryStatus,      _COMMS,  1.0,          1, "charge of the batteries, of robots that have some")
CONTROL_MODE    = Topic("valor_ros_controller/control_mode", m.ControlModeReport, _VRC,    10.0,         1, "the VRC's control mode", latched=True)
CYCLE           = Topic("valor_ros_controller/cycle",        m.ControllerCycle,   _VRC,    None,         0, "end of a cycle of the VRC")
GROUND_TRUTH    = Topic("simulation/ground_truth",           m.GroundTruth,       _COMMS,  100.0,        1, "the simulator's truth; no controller may read it", (_EMULATORS,))

HDT_COMMANDS = {
    limb: Topic(f"comms_manager/hdt/{limb}/command", m.HdtCommand, _COMMS, None, 1, "joint impedance of an HDT limb; hardware only")
    for limb in ("left_arm", "right_arm", "left_hand", "right_hand")
}
HDT_STATES = {
    limb: Topic(f"comms_manager/hdt/{limb}/state", m.HdtState, _HDT_BRIDGE, None, 1, "state of an HDT limb from its driver; hardware only")
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
STOP          = ServiceTopic("comms_manager/stop",           m.BehaviorRequest,     m.BehaviorReply,     _COMMS,  "fall, soft_stop or freeze, while no Motion Manager controls the robot")
CONTROLLER    = ServiceTopic("motion_manager/controller",    m.ControllerRequest, m.ControllerReply,   _MOTION, "choose the controller of the balancing robot")
FOOTSTEP_PLAN = ServiceTopic("motion_manager/footstep_plan", m.FootstepPlanRequest, m.FootstepPlanReply, _MOTION, "execute, update or stop a footstep plan")
PUSH          = ServiceTopic("simulation/push",              m.PushRequest,         m.PushReply,         _COMMS,  "push a body of the robot; simulation only", (_EMULATORS,))
SIMULATED_TIME = ServiceTopic("simulation/time",             m.TimeRequest,         m.TimeReply,         _COMMS,  "pause, step, slow down; simulation without devices only")
FAULT         = ServiceTopic("simulation/fault",             m.FaultRequest,        m.FaultReply,        _EMULATORS, "fault of an emulated device; hardware without a robot only")
SNAP          = ServiceTopic("bag_recorder/snap",            m.SnapRequest,         m.SnapReply,         _RECORDER, "save the last seconds that the recorder holds")
MARK          = ServiceTopic("bag_recorder/mark",            m.MarkRequest,         m.MarkReply,         _RECORDER, "mark in the recording, with a text")
# fmt: on

SERVICE_TOPICS: tuple[ServiceTopic[Any, Any], ...] = tuple(
    row for row in list(globals().values()) if isinstance(row, ServiceTopic)
)


def hdt_topics(limb: str) -> tuple[Topic[m.HdtCommand], Topic[m.HdtState]]:
    """Command and state topics of an HDT limb, by its name in robot.yaml. Raises ConfigurationError if it has none."""
    if limb not in HDT_COMMANDS:
        raise ConfigurationError(
            f"robot.yaml: devices: limb {limb!r} has no Bifrost topics; expected one of {', '.join(HDT_COMMANDS)}"
        )
    return HDT_COMMANDS[limb], HDT_STATES[limb]


def network(instance: Instance, owner: str = "") -> bifrost.Network:
    """The network of an instance that is up, for its process ``owner``, or else for a member.

    A member may subscribe to all topics, call all services, and publish topics without owner. Raises
    ``bifrost.ConfigurationError``: the network file or a key is missing or wrong.
    """
    own_key = own_key_file(instance.owners, owner) if owner else None
    return bifrost.Network.load(instance.network_file, instance.keys, own_key=own_key)


def access_policy(instance: Instance) -> bifrost.AccessPolicy:
    """Owners of all topics and services, as in the table."""
    return bifrost.AccessPolicy(
        instance.owners,
        {topic.name: topic.publishers for topic in TOPICS},
        {service.name: service.servers for service in SERVICE_TOPICS},
    )
