"""`walk`: publication of ``/cmd_vel`` for a time or a distance, and measurement of the walk.

With ``--straight`` the velocity is corrected for the errors from the line of the start::

    e = (p − p₀)·n                                  offset from the line, n to its left [m]
    v = speed·t − clip(g·e, ±SIDEWAYS)·n            in odom; rotated into the robot's heading ψ
    w = −clip(h·(ψ − ψ₀), ±TURNING)

The gains are low, so that the correction does not follow the sway of the steps.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import bifrost
from valor.common import rotation
from valor.common.behaviors import WALKING, WALKING_MODES, Behavior, ControlMode
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import MotionState
from valor.common.topics import MOTION_STATE, VELOCITY
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import Walking as Limits
from valor.valorctl.drive import control_mode
from valor.valorctl.drive.node import join, next_message

TOPIC = "cmd_vel"
PERIOD = 0.02  # between commands; robot time may be faster than wall time [s]
REST_SPEED = 0.02  # of a pelvis at rest, at most [m/s]
REST_DURATION = 0.5  # with at most that speed [robot time, s]
STOP_TIMEOUT = 20.0  # [robot time, s]
STATE_TIMEOUT = 5.0  # without MotionState [s]
OTHERS = 1_000_000_000  # duration of the check for another client's velocities [robot time, ns]
OFFSET_GAIN = 0.3  # g [1/s]
HEADING_GAIN = 0.6  # h [1/s]
SIDEWAYS = 0.06  # correction, at most [m/s]
TURNING = 0.15  # correction, at most [rad/s]
_SLOWEST = 0.3  # share of the requested speed, by which a distance times out
_START_TIME = 10.0  # in addition [robot time, s]

Velocity = tuple[float, float, float]  # forward, left [m/s], turning left [rad/s]


@dataclass(frozen=True)
class WalkRequest:
    """Velocity, and duration or distance; at least one of them."""

    forward: float = 0.0  # [m/s]
    left: float = 0.0  # [m/s]
    turn: float = 0.0  # [rad/s]
    seconds: float | None = None  # at most [robot time, s]
    distance: float | None = None  # along the line of the start [m]
    straight: bool = False  # correct for the offset from the line and its heading, as estimated

    def __post_init__(self) -> None:
        ends = {"--for": self.seconds, "--distance": self.distance}
        for name, value in {"--vx": self.forward, "--vy": self.left, "--wz": self.turn, **ends}.items():
            if value is not None and not math.isfinite(value):
                raise ValorError(f"{name} {value}: expected a finite number")
            if value is not None and name in ends and value <= 0.0:
                raise ValorError(f"{name} {value:g}: expected more than 0")
        if self.seconds is None and self.distance is None:
            raise ValorError("no end: expected --for or --distance")
        if not self.speed and not self.turn:
            raise ValorError("no velocity: expected --vx, --vy or --wz other than 0")
        if self.distance is not None and not self.speed:
            raise ValorError(f"--distance {self.distance:g}: expected --vx or --vy other than 0")
        if self.straight and self.turn:
            raise ValorError(f"--straight keeps the heading: expected no --wz, not {self.turn:g}")

    def require_within(self, limits: Limits, robot: str) -> None:
        """Raise ``ValorError`` with option, value and limits if the velocity exceeds a robot's limits."""
        for name, value, lowest, highest, unit in (
            ("--vx", self.forward, -limits.max_backward_speed, limits.max_forward_speed, "m/s"),
            ("--vy", self.left, -limits.max_lateral_speed, limits.max_lateral_speed, "m/s"),
            ("--wz", self.turn, -limits.max_turn_rate, limits.max_turn_rate, "rad/s"),
        ):
            if not lowest <= value <= highest:
                raise ValorError(f"{name} {value:g}: {robot} walks at {lowest:g} to {highest:g} {unit}")

    @property
    def speed(self) -> float:
        """[m/s]."""
        return math.hypot(self.forward, self.left)

    @property
    def longest(self) -> float:
        """Duration after which the velocity ends, whatever the distance [robot time, s]."""
        if self.seconds is not None:
            return self.seconds
        assert self.distance is not None
        return self.distance / (_SLOWEST * self.speed) + _START_TIME


@dataclass(frozen=True)
class Walk:
    """Result of a walk, by the robot's estimate."""

    distance: float  # of the pelvis, from start to rest [m]
    offset: float  # of that, to the left of the line [m]
    turned: float  # change of heading, anticlockwise [rad]
    duration: float  # until rest [robot time, s]
    fell: bool
    reason: str  # for leaving Walk; empty: the robot still walks or stands in it
    dcm_error: float  # mean distance of the DCM from its reference [m]

    def describe(self) -> str:
        """One line."""
        return f"{self.distance:.2f} m in {self.duration:.1f} s, mean DCM error {self.dcm_error * 1e3:.1f} mm"

    @property
    def failure(self) -> str:
        """Why the walk was not completed, in one line; empty if it was."""
        return f"walked {self.describe()}, then {self.reason}" if self.reason else ""


def walk(
    instance: Instance,
    request: WalkRequest,
    check: Callable[[], None],
    tell: Callable[[float, float], None] = lambda passed, way: None,
) -> Walk:
    """Enter mode ``walk``, walk, stop, and enter the previous mode again.

    ``check`` may raise: the robot then stops 0.5 s after the last velocity. ``tell`` receives robot time [s] and
    distance [m]. Raises ``ValorError``: limits exceeded, robot fallen, mode rejected, another client, or no response.
    """
    from geometry_msgs.msg import Twist

    from valor.valorctl.drive.ros_client import RosClient

    robot = RobotDescription.load(instance.settings().robot)
    request.require_within(robot.tables.walking, robot.name)
    report = control_mode.report(instance)
    if report.behavior == Behavior.FALL:
        raise ValorError("the robot has fallen: `valorctl status` shows the way out")
    before = report.current_control_mode
    with join(instance) as node, RosClient(instance, check) as ros:
        if before in WALKING_MODES:
            _require_no_other_client(node)
        publisher, twist = ros.publisher(Twist, TOPIC, 1), Twist()
        if before not in WALKING_MODES:
            control_mode.enter(instance, ControlMode.WALK, check)
        states = MOTION_STATE.subscriber(node, queue=5000)
        run = _Run(request, next_message(MOTION_STATE, states, STATE_TIMEOUT))
        last = time.monotonic()
        while not run.over:
            check()
            if received := states.drain():
                last = time.monotonic()
                run.consider([each.message for each in received])
                if run.commanding:
                    twist.linear.x, twist.linear.y, twist.angular.z = run.velocity()
                    publisher.publish(twist)
                tell(run.passed, run.way)
            elif time.monotonic() - last > STATE_TIMEOUT:
                raise ValorError(f"no {MOTION_STATE.name} for {STATE_TIMEOUT:g} s; see `valorctl status`")
            time.sleep(PERIOD)
    result = run.result()
    if before not in WALKING_MODES and not result.reason:
        control_mode.enter(instance, before, check)
    return result


def _require_no_other_client(node: bifrost.Node) -> None:
    """Raise ``ValorError`` if another client, perhaps as slow as robot time, publishes velocities."""
    velocities, states = VELOCITY.subscriber(node), MOTION_STATE.subscriber(node)
    until = next_message(MOTION_STATE, states, STATE_TIMEOUT).time + OTHERS
    while next_message(MOTION_STATE, states, STATE_TIMEOUT).time < until:
        if velocities.latest() is not None:
            raise ValorError(f"another client already publishes /{TOPIC}; expected none; stop it, then retry")


class CourseLine:
    """Line from the pelvis at the start, along the requested velocity."""

    def __init__(self, state: MotionState, forward: float, left: float) -> None:
        self._start = state.pelvis_position_in_odom[:2].copy()
        self._heading = _heading(state)
        self._speed = math.hypot(forward, left)
        direction = self._heading + math.atan2(left, forward)
        self._along = (math.cos(direction), math.sin(direction))

    def place(self, state: MotionState) -> tuple[float, float]:
        """Distance along the line, and to its left [m]."""
        x, y = (state.pelvis_position_in_odom[:2] - self._start).tolist()
        cos, sin = self._along
        return x * cos + y * sin, y * cos - x * sin

    def turned(self, state: MotionState) -> float:
        """Change of heading since the start, anticlockwise [rad]."""
        return math.remainder(_heading(state) - self._heading, 2.0 * math.pi)

    def steer(self, state: MotionState) -> Velocity:
        """Corrected velocity."""
        _, offset = self.place(state)
        back = -float(np.clip(OFFSET_GAIN * offset, -SIDEWAYS, SIDEWAYS))
        cos, sin = self._along
        x, y = self._speed * cos - back * sin, self._speed * sin + back * cos
        psi = _heading(state)
        forward, left = x * math.cos(psi) + y * math.sin(psi), y * math.cos(psi) - x * math.sin(psi)
        return forward, left, -float(np.clip(HEADING_GAIN * self.turned(state), -TURNING, TURNING))


class _Run:
    """State of a walk in progress: ``passed`` since the start [robot time, s], ``way`` along the line [m].

    ``commanding`` until its end; ``over`` when the robot rests, did not stop in time, or left the walking behaviors.
    """

    def __init__(self, request: WalkRequest, began: MotionState) -> None:
        self._request = request
        self._began = self._state = began
        self._line = CourseLine(began, request.forward, request.left)
        self._errors: list[float] = []
        self._moved = began.time  # latest motion of the pelvis [robot time, ns]
        self._stopped = 0.0  # end of the velocities [robot time, s]
        self._lost = ""  # why the walk cannot be followed any more
        self.commanding, self.over = True, False
        self.passed = self.way = 0.0
        self.consider([began])

    def consider(self, states: Sequence[MotionState]) -> None:
        """Process new states, up to the end of the walk."""
        for state in states:
            if state.time < self._state.time:
                self.over, self._lost = True, "robot time restarted: the Comms Manager was restarted"
            if self.over:
                return
            self._consider(state)

    def _consider(self, state: MotionState) -> None:
        self._state = state
        self._errors.append(float(np.linalg.norm(state.dcm_in_odom - state.dcm_reference_in_odom)))
        if np.linalg.norm(state.pelvis_linear_velocity_in_odom) > REST_SPEED:
            self._moved = state.time
        self.passed = 1e-9 * (state.time - self._began.time)
        self.way = self._line.place(state)[0]
        distance, longest = self._request.distance, self._request.longest
        if self.commanding and (self.passed >= longest or (distance is not None and self.way >= distance)):
            self.commanding, self._stopped = False, self.passed
        since = self.passed - self._stopped
        rested = since > 1.0 and 1e-9 * (state.time - self._moved) > REST_DURATION
        self.over = state.behavior not in WALKING or (not self.commanding and (rested or since > STOP_TIMEOUT))

    def velocity(self) -> Velocity:
        """Velocity to publish now."""
        request = self._request
        return self._line.steer(self._state) if request.straight else (request.forward, request.left, request.turn)

    def result(self) -> Walk:
        """Result so far."""
        state = self._state
        way = state.pelvis_position_in_odom - self._began.pelvis_position_in_odom
        return Walk(
            distance=float(np.hypot(way[0], way[1])),
            offset=self._line.place(state)[1],
            turned=self._line.turned(state),
            duration=self.passed,
            fell=state.behavior == Behavior.FALL,
            reason=self._lost or ("" if state.behavior in WALKING else f"{state.behavior}: {state.reason}"),
            dcm_error=float(np.mean(self._errors)),
        )


def _heading(state: MotionState) -> float:
    """Heading of the pelvis in odom [rad]."""
    return rotation.heading(state.pelvis_orientation_in_odom.tolist())
