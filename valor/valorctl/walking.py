"""Walking at a velocity for a while or for a distance, and how well it went."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

import bifrost
from valor.analysis.track_builder import TrackBuilder
from valor.analysis.walk import Figures, Timeliness, Track
from valor.analysis.walk_report import WalkReport
from valor.common.behaviors import WALKING, WALKING_MODES, Behavior, ControlMode
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import ClockStatus, MotionState, VelocityCommand
from valor.common.topics import CLOCK, MOTION_STATE, PROPRIOCEPTOR, VALORCTL, VELOCITY
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import Walking as Limits
from valor.valorctl import control_mode
from valor.valorctl.node import join
from valor.valorctl.steering import Line

PERIOD = 0.02  # between commands; robot time may pass faster than the wall's [s]
REST_SPEED = 0.02  # of a pelvis at rest [m/s]
REST_DURATION = 0.5  # for which it must be [robot time, s]
LONGEST_STOP = 20.0  # [robot time, s]
SILENCE = 5.0  # of the Motion Manager, after which it is given up [s]
SILENT = f"{MOTION_STATE.name} is silent for {SILENCE:g} s: see `valorctl status`"
BEGUN_ANEW = "robot time restarted: the Comms Manager was restarted"
OTHERS = 1.0  # to hear whether somebody else leads a robot that walks already [robot time, s]
_SLOWEST = 0.3  # of the speed asked for: a distance must be done by then
_TO_BEGIN = 10.0  # and so long more [robot time, s]


@dataclass(frozen=True)
class Order:
    """What to walk. One of ``seconds`` and ``distance`` may be left out."""

    forward: float = 0.0  # [m/s]
    left: float = 0.0  # [m/s]
    turn: float = 0.0  # [rad/s]
    seconds: float | None = None  # at most [robot time, s]
    distance: float | None = None  # to go, after which the robot is told to stop [m]
    straight: bool = False  # keep heading and line, as the robot estimates them

    def __post_init__(self) -> None:
        given = {"--for": self.seconds, "--distance": self.distance}
        for name, value in {"--vx": self.forward, "--vy": self.left, "--wz": self.turn, **given}.items():
            if value is not None and not math.isfinite(value):
                raise ValorError(f"{name} {value}: expected a finite number")
        for name, value in given.items():
            if value is not None and value <= 0.0:
                raise ValorError(f"{name} {value:g}: expected more than 0")
        if self.seconds is None and self.distance is None:
            raise ValorError("how long to walk: expected --for or --distance")
        if not self.speed and not self.turn:
            raise ValorError("where to walk: expected --vx, --vy or --wz other than 0")
        if self.distance is not None and not self.speed:
            raise ValorError(f"--distance {self.distance:g}: expected --vx or --vy other than 0")
        if self.straight and self.turn:
            raise ValorError(f"--straight keeps the heading: expected no --wz, not {self.turn:g}")

    def require_within(self, limits: Limits, robot: str) -> None:
        """Check the velocity against what a robot walks.

        Raises:
            ValorError: it does not walk so; names option, value and limits.
        """
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
        """After which the robot is told to stop, wherever it is [robot time, s]."""
        if self.seconds is not None:
            return self.seconds
        assert self.distance is not None
        return self.distance / (_SLOWEST * self.speed) + _TO_BEGIN


@dataclass(frozen=True)
class Walk:
    """What became of a walk, as the robot itself believes."""

    distance: float  # of the pelvis, from where it began to where it came to rest [m]
    offset: float  # of that, to the left of the line along the velocity asked for [m]
    turned: float  # heading at the end against that at the beginning [rad]
    duration: float  # until rest [robot time, s]
    fell: bool
    reason: str  # of leaving Walk, if it did
    dcm_error: float  # mean distance of the DCM from its reference [m]
    pause: float  # longest between two velocities, in which the robot begins to stop after 0.5 s [robot time, s]
    report: WalkReport | None  # None: nothing was measured while it lasted
    track: Track | None = None  # likewise

    def describe(self) -> str:
        """One line."""
        return f"{self.distance:.2f} m in {self.duration:.1f} s, mean DCM error {self.dcm_error * 1e3:.1f} mm"


def walk(
    instance: Instance,
    order: Order,
    check: Callable[[], None],
    tell: Callable[[float, float], None] = lambda passed, way: None,
) -> Walk:
    """Go to mode ``walk``, walk, stop, and go back to the mode before.

    Args:
        instance: a running system.
        order: what to walk.
        check: raises when the user wants to stop; the robot then stops by itself.
        tell: is told of progress: robot time [s] and way [m].

    Raises:
        ValorError: the robot does not walk so or has fallen, mode refused, somebody else leads it, nobody answers.
    """
    robot = RobotDescription.load(instance.settings().robot)
    order.require_within(robot.tables.walking, robot.name)
    report = control_mode.report(instance)
    if report.behavior == Behavior.FALL:
        raise ValorError("the robot has fallen: see `valorctl get-up`")
    before = report.current_control_mode
    with join(instance, owner=VALORCTL) as node:
        if before in WALKING_MODES:
            _require_nobody_leads(node)
        else:
            control_mode.enter(instance, ControlMode.WALK, check)
        result = _walk(node, robot, order, check, tell)
    if before not in WALKING_MODES and not result.reason:
        control_mode.enter(instance, before, check)
    return result


def _require_nobody_leads(node: bifrost.Node) -> None:
    """Two who lead a robot would each have half of their way. Who leads it may be as starved as the robot's clock is:
    it is listened to for so long in robot time.

    Raises:
        ValorError: somebody else's velocities come, or the Motion Manager is silent.
    """
    velocities, states = VELOCITY.subscriber(node), MOTION_STATE.subscriber(node)
    until: int | None = None  # robot time [ns]
    while True:
        state = states.receive(timeout=SILENCE)
        if (heard := velocities.latest()) is not None:
            raise ValorError(f"the robot is being walked already: velocities come from {heard.origin}")
        if state is None:
            raise ValorError(SILENT)
        until = state.message.time + round(OTHERS * 1e9) if until is None else until
        if state.message.time >= until:
            return


def _walk(
    node: bifrost.Node,
    robot: RobotDescription,
    order: Order,
    check: Callable[[], None],
    tell: Callable[[float, float], None],
) -> Walk:
    states = MOTION_STATE.subscriber(node, queue=5000)
    measured = PROPRIOCEPTOR.subscriber(node, queue=5000)
    clock = CLOCK.subscriber(node, queue=100)
    track, clocks = TrackBuilder(robot), list[ClockStatus]()
    commands = VELOCITY.publisher(node)
    run: _Run | None = None
    heard = time.monotonic()
    while run is None or not run.over:
        check()
        received = states.drain()
        if received:
            heard = time.monotonic()
            run = run or _Run(order, received[0].message)
            lasted = run.consider([each.message for each in received])
            track.add(lasted, [each.message for each in measured.drain()])
            clocks += [each.message for each in clock.drain()]
            if run.asking:
                commands.publish(run.command())
            tell(run.passed, run.way)
        elif time.monotonic() - heard > SILENCE:
            raise ValorError(SILENT)
        time.sleep(PERIOD)
    track.add([], [each.message for each in measured.drain()])
    walked = track.track()
    if walked is None or walked.time.size < 2:
        return run.result(None)
    result = run.result(WalkReport(Figures.of(walked), Timeliness.heard(clocks, walked, robot)))
    return replace(result, track=walked)


class _Run:
    """One walk while it lasts.

    Attributes:
        asking: the robot is still asked to walk.
        over: it has come to rest, was given too long, or is in no behavior that walks.
        passed: since the beginning [robot time, s].
        way: along the line [m].
    """

    def __init__(self, order: Order, began: MotionState) -> None:
        self._order = order
        self._began = self._state = began
        self._line = Line(began, order.forward, order.left)
        self._errors: list[float] = []
        self._moved = began.time  # when the pelvis moved last
        self._stopped = 0.0  # when it was no more asked to walk
        self._commanded = self._pause = 0.0  # when it was asked last, and the longest time between [robot time, s]
        self._lost = ""  # why the walk cannot be followed any more
        self.asking, self.over = True, False
        self.passed = self.way = 0.0

    def consider(self, states: Sequence[MotionState]) -> Sequence[MotionState]:
        """Take the robot's next states in; returns those until the walk was over."""
        for place, state in enumerate(states):
            if state.time < self._state.time:
                self.over, self._lost = True, BEGUN_ANEW
                return states[:place]
            self._consider(state)
            if self.over:
                return states[: place + 1]
        return states

    def _consider(self, state: MotionState) -> None:
        self._state = state
        self._errors.append(float(np.linalg.norm(state.dcm_in_odom - state.dcm_reference_in_odom)))
        if np.linalg.norm(state.pelvis_linear_velocity_in_odom) > REST_SPEED:
            self._moved = state.time
        self.passed = 1e-9 * (state.time - self._began.time)
        self.way = self._line.place(state)[0]
        distance, longest = self._order.distance, self._order.longest
        if self.asking and (self.passed >= longest or (distance is not None and self.way >= distance)):
            self.asking, self._stopped = False, self.passed
        since = self.passed - self._stopped
        rested = since > 1.0 and 1e-9 * (state.time - self._moved) > REST_DURATION
        self.over = state.behavior not in WALKING or (not self.asking and (rested or since > LONGEST_STOP))

    def command(self) -> VelocityCommand:
        """What to ask for now."""
        order, state = self._order, self._state
        self._pause = max(self._pause, self.passed - self._commanded)
        self._commanded = self.passed
        straight = self._line.steer(state) if order.straight else (order.forward, order.left, order.turn)
        x, y, turn = straight
        return VelocityCommand(time=state.time, linear_x=x, linear_y=y, angular_z=turn)

    def result(self, report: WalkReport | None) -> Walk:
        """What became of it."""
        state, began = self._state, self._began
        way = state.pelvis_position_in_odom - began.pelvis_position_in_odom
        return Walk(
            distance=float(np.hypot(way[0], way[1])),
            offset=self._line.place(state)[1],
            turned=self._line.turned(state),
            duration=self.passed,
            fell=state.behavior == Behavior.FALL,
            reason=self._lost or ("" if state.behavior in WALKING else f"{state.behavior}: {state.reason}"),
            dcm_error=float(np.mean(self._errors)),
            pause=self._pause,
            report=report,
        )
