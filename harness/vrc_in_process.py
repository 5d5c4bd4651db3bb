"""The VRC's update loop against the Motion Manager's state machines, period by period in one thread.

Both sides are the real ones: the VRC from its Bifrost interface to its trajectory controllers, the Motion Manager's
behavior FSM, its handlers and the references of its joints. What is in between is not: messages and time pass as told,
so that every order of events can be tried, late and lost messages among them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from bifrost import Received
from harness.motion_states import motion_state
from harness.places import ROBOTS
from valor.common import topics
from valor.common.arrays import FloatArray
from valor.common.behaviors import OPERATIONAL, Behavior, Locomotion, Manipulation
from valor.common.messages import BehaviorReply, BehaviorRequest, MotionState, Proprioceptor
from valor.motion_manager.behavior_fsm import BehaviorFsm, Conditions
from valor.motion_manager.handlers.behavior import BehaviorHandler
from valor.motion_manager.handlers.handler import RejectionCounter
from valor.motion_manager.handlers.joint_setpoints import JointSetpointsHandler
from valor.motion_manager.handlers.motion import HandGoalHandler
from valor.motion_manager.hands.hand_goals import HandGoals
from valor.motion_manager.joints.joint_reference import JointReference
from valor.motion_manager.joints.upper_body import UpperBody
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.limiter import Limiter
from valor.robot.model import controller_model
from valor.valor_ros_controller.behavior_transition import BehaviorAnswer
from valor.valor_ros_controller.control_modes import ControlModeTable, ModeReport
from valor.valor_ros_controller.controllers.table import ControllersTable
from valor.valor_ros_controller.core import Core
from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer

ROBOT = RobotDescription.load(ROBOTS / "escher")
MODEL = controller_model(ROBOT)
MODES, CONTROLLERS = ControlModeTable.load(), ControllersTable.load()
N = len(ROBOT.joints)
PERIOD = round(1e9 * ROBOT.control_period)
SILENCE = 15 * PERIOD * 1e-9  # of a process, to the VRC [s]
PATIENCE = 22  # periods that a call waits for its reply
NOT_IN_ODOM: Any = None  # where the robot is: goals of hands are in pelvis
SAG = 0.04  # joints hang so far below what is commanded [rad]


class Mailbox:
    """A topic with the newest message alone, as publisher and as subscriber; ``heard`` is shown each message."""

    def __init__(self) -> None:
        self._newest: Received[Any] | None = None
        self._sequence = 0
        self.woken = False  # whoever waits for a message
        self.publishers: tuple[str, ...] = ("test",)  # that are there
        self.heard: Callable[[Any], None] = lambda message: None

    def publish(self, message: Any) -> None:
        self._sequence += 1
        self._newest = Received(message, 0, self._sequence, "test")
        self.heard(message)

    def latest(self) -> Received[Any] | None:
        newest, self._newest = self._newest, None
        return newest

    def drain(self, limit: int) -> list[Received[Any]]:
        newest = self.latest()
        return [] if newest is None else [newest]

    def wake(self) -> None:
        self.woken = True

    def receive(self, timeout: float) -> Received[Any] | None:
        self.woken = False
        return self.latest()


@dataclass
class Network:
    """Topics by name, in the place of a Bifrost node."""

    topics: dict[str, Mailbox] = field(default_factory=dict)
    name = "test"

    def topic(self, name: str) -> Mailbox:
        return self.topics.setdefault(name, Mailbox())

    def subscriber(self, name: str, _: type, **options: Any) -> Mailbox:
        return self.topic(name)

    publisher = subscriber


@dataclass
class Call:
    """A request under way."""

    number: int
    behavior: str
    arrives: int  # in so many periods
    patience: int = PATIENCE
    reply: BehaviorReply | None = None
    returns: int = 0


class Commander:
    """One call at a time, newest first; requests and replies take their time or are lost."""

    def __init__(self, answered: Callable[[], None]) -> None:
        self.answers: RealTimeBuffer[BehaviorAnswer] = RealTimeBuffer()
        self.answered = answered
        self.delays = (0, 0)  # of requests and of replies [periods]
        self.lose_requests = self.lose_replies = False
        self.asked = 0  # how often
        self._waiting: tuple[int, str] | None = None
        self._call: Call | None = None

    def request(self, number: int, behavior: str) -> None:
        self.asked += 1
        self._waiting = (number, behavior)

    def discard(self) -> None:
        self._waiting = None

    def close(self) -> None: ...

    def period(self, serve: Callable[[BehaviorRequest], BehaviorReply] | None) -> bool:
        """One period of the network; returns whether an answer has come."""
        if self._call is None and self._waiting is not None:
            self._call, self._waiting = Call(*self._waiting, arrives=self.delays[0]), None
        call = self._call
        if call is None:
            return False
        call.patience -= 1
        if call.patience < 0:
            self._end(BehaviorAnswer(call.number, False, "no reply", silent=True))
            return True
        if call.arrives >= 0:
            call.arrives -= 1
            if call.arrives < 0 and serve and not self.lose_requests:
                reply = serve(BehaviorRequest(call.behavior))
                if not self.lose_replies:
                    call.reply, call.returns = reply, self.delays[1]
        elif call.reply is not None:
            call.returns -= 1
            if call.returns < 0:
                reply = call.reply
                answer = BehaviorAnswer(call.number, reply.accepted, reply.reason, reply.behavior)
                self._end(replace(answer, obstacle=reply.obstacle))
                return True
        return False

    def _end(self, answer: BehaviorAnswer) -> None:
        self._call = None
        self.answers.write(answer)


class MotionSystem:
    """The Motion Manager without its Whole-Body Controller: joints are where its references are, less some sag."""

    def __init__(self, time: int, position: FloatArray) -> None:
        self.fsm = BehaviorFsm()
        self.reference = JointReference(ROBOT)
        height = ROBOT.tables.nominal_base_height
        self._pelvis = Limiter(CommandedLimits.of_pelvis(ROBOT))
        self._pelvis_target = np.array((0.0, 0.0, height, 0.0, 0.0, 0.0))
        self._pelvis.reset(np.ones(6, dtype=bool), self._pelvis_target)
        self.rejections = RejectionCounter()
        self._upper_body = UpperBody(ROBOT, self.reference)
        self.hands = HandGoals(MODEL, self.reference, ROBOT.nominal_posture)
        self.authority = SimpleNamespace(since=time, rejection=lambda _: "")
        components: Any = SimpleNamespace(
            robot=ROBOT, fsm=self.fsm, rejections=self.rejections, upper_body=self._upper_body, hand_goals=self.hands,
            conditions=Conditions, authority=self.authority,
        )  # fmt: skip
        self._behavior = BehaviorHandler(components)
        self._hand_goal = HandGoalHandler(components)
        self._setpoints = JointSetpointsHandler(components)
        self._was = Behavior.IDLE
        self.take_up(position)
        self.fsm.go(Behavior.STAND_PREP, "first Proprioceptor")

    def take_up(self, position: FloatArray) -> None:
        """Begin with the joints where they are."""
        self.reference.take_up(np.ones(N, dtype=bool), position)

    def serve(self, request: BehaviorRequest) -> BehaviorReply:
        return self._behavior.handle(request, "valor_ros_controller")

    def go(self, behavior: Behavior, reason: str) -> bool:
        """Change by itself, if there is a way."""
        possible = self.fsm.behavior in OPERATIONAL and self.fsm.may_go(behavior)
        if possible:
            self.fsm.go(behavior, reason)
        return possible

    def period(self, time: int, sequence: int, position: FloatArray, network: Network) -> MotionState:
        """Hear, move, report."""
        now = time * 1e-9
        if received := network.topic(topics.JOINT_SETPOINTS.name).latest():
            self._setpoints.handle(received, time)
        if received := network.topic(topics.HAND_GOAL.name).latest():
            self._hand_goal.handle(received, time)
        if received := network.topic(topics.PELVIS.name).latest():
            self._pelvis_target = received.message.position
        fsm = self.fsm
        self._upper_body.enter(fsm.manipulation, fsm.attention, now)
        if fsm.locomotion is Locomotion.FALL:
            self.take_up(position)
        elif fsm.behavior is not self._was and fsm.locomotion in (Locomotion.STAND_PREP, Locomotion.FREEZE):
            self.reference.hold(np.ones(N, dtype=bool))
        self._was = fsm.behavior
        self._upper_body.update(position, now)
        if self.hands.active and fsm.manipulation is not Manipulation.TELEOP:
            self.hands.release_all(f"the behavior is {fsm.behavior}")
        self.hands.advance(NOT_IN_ODOM, self.reference.position, now, PERIOD * 1e-9)
        self.reference.advance(now, PERIOD * 1e-9)
        self._pelvis.advance(self._pelvis_target, np.zeros(6), PERIOD * 1e-9)
        teleop = fsm.manipulation is Manipulation.TELEOP
        left, right = (
            ("hand_goal" if self.hands.leads(side) else "setpoints") if teleop else "nobody" for side in (0, 1)
        )
        return motion_state(
            left_arm=left,
            right_arm=right,
            time=time,
            proprioceptor_sequence=sequence,
            behavior=str(fsm.behavior),
            locomotion=str(fsm.locomotion),
            manipulation=str(fsm.manipulation),
            attention=str(fsm.attention),
            reason=fsm.reason,
            joint_setpoint=self.reference.position.copy(),
            pelvis_setpoint=self._pelvis.position.copy(),
            pelvis_in_support=self._pelvis.position.copy(),
        )


@dataclass
class ModeClient:
    """Keeps what it is told."""

    asked: str = ""
    seen: list[ModeReport] = field(default_factory=list)
    result: ModeReport | None = None

    def processing(self, report: ModeReport) -> None:
        self.seen.append(report)

    def finish(self, report: ModeReport) -> None:
        assert self.result is None, "finished twice"
        self.result = report

    @property
    def report(self) -> ModeReport:
        """The result, which has come."""
        assert self.result is not None
        return self.result


class System:
    """Robot, Motion System and VRC.

    Attributes:
        after: called after every update of the VRC.
        vrc_late: the VRC does not get round to a cycle.
    """

    def __init__(self) -> None:
        self.time, self.sequence, self.clock = 1_000_000_000, 0, 0.0
        self.position = ROBOT.nominal_posture - SAG
        self.network = Network()
        self.motion: MotionSystem | None = MotionSystem(self.time, ROBOT.nominal_posture)
        self.frozen = False  # the Motion System neither hears nor speaks
        self.after: Callable[[], None] = lambda: None
        self.vrc_late = False
        self.start_vrc()

    def start_vrc(self) -> None:
        """A VRC that knows nothing."""
        self.vrc = Core(
            ROBOT,
            self.network,  # type: ignore[arg-type]
            self._make_commander,  # type: ignore[arg-type]
            decimation=2,
            silence_timeout=SILENCE,
            clock=lambda: self.clock,
        )

    def _make_commander(self, answered: Callable[[], None]) -> Commander:
        self.commander = Commander(answered)
        return self.commander

    def restart_motion_manager(self) -> None:
        """A Motion Manager that knows nothing."""
        self.motion = MotionSystem(self.time, self.position)

    def restart_comms_manager(self) -> None:
        """Another world, whose time begins anew: the Motion System has lost the robot."""
        self.time, self.sequence = 0, 0
        if self.motion is not None:
            self.motion.go(Behavior.FALL, "robot time went back")
            self.motion.authority.since = 0

    def ask(self, mode: str) -> ModeClient:
        """Ask for a control mode."""
        client = ModeClient(mode)
        self.vrc.mode_controller.request(mode, client)
        return client

    def run(self, periods: int = 1, until: Callable[[], bool] = lambda: False) -> None:
        """Let time pass."""
        for _ in range(periods):
            self.period()
            if until():
                return

    def period(self) -> None:
        self.time += PERIOD
        self.sequence += 1
        self.clock += PERIOD * 1e-9
        self._publish_proprioceptor()
        motion = None if self.frozen else self.motion
        if motion is not None:
            state = motion.period(self.time, self.sequence, self.position, self.network)
            self.network.topic(topics.MOTION_STATE.name).publish(state)
            if motion.fsm.behavior is not Behavior.FALL:
                self.position = state.joint_setpoint - SAG
        if self.commander.period(motion.serve if motion else None):
            self.commander.answered()
        # As the loop does: at every second Proprioceptor, at every one during a transition, and whenever woken.
        interface = self.vrc.interface
        woken = self.network.topic(topics.PROPRIOCEPTOR.name).woken
        if not self.vrc_late and (woken or interface.in_transition or self.sequence % 2 == 0):
            self.vrc.update(self.vrc.wait())
            self.after()

    def _publish_proprioceptor(self) -> None:
        nothing = np.zeros(6)
        self.network.topic(topics.PROPRIOCEPTOR.name).publish(
            Proprioceptor(
                time=self.time, sequence=self.sequence, motor_sequence=0,
                joint_position=self.position, joint_velocity=np.zeros(N), joint_effort=np.zeros(N),
                imu_orientation=np.array([1.0, 0.0, 0.0, 0.0]), imu_angular_velocity=np.zeros(3),
                imu_linear_acceleration=np.array([0.0, 0.0, 9.81]),
                kvh_angular_velocity=np.zeros(0), kvh_linear_acceleration=np.zeros(0),
                left_foot_wrench=nothing, right_foot_wrench=nothing,
                left_hand_wrench=nothing, right_hand_wrench=nothing, battery_voltage=48.0, motor_behavior="stand",
            )
        )  # fmt: skip
