"""Table of demonstrations, and the steps that they consist of."""

import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from valor.common.behaviors import ControlMode
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.resources import example_file
from valor.common.topics import GROUND_TRUTH
from valor.manipulation.known import TASKS
from valor.manipulation.plan import REACHED, RESISTED, HandMove, Plan
from valor.ros.limbs import HANDS
from valor.valorctl.demos.demonstration import WORLD, Context, Demo, Picture, course, speed
from valor.valorctl.drive import arm_motion, control_mode, stepping
from valor.valorctl.drive.node import join, next_message
from valor.valorctl.drive.walking import WalkRequest
from valor.valorctl.terminal.console import say_rows

HAND = HANDS[1]
GOAL, CANCEL, STATUS = (f"flor/{HAND}/goal_{what}" for what in ("pose", "cancel", "status"))
ODOM = "odom"

_ACCEPT_TIMEOUT = 20.0  # of the first status of a goal [s]
_REPEAT_PERIOD = 2.0  # of a goal that is not accepted yet [s]
_SLOWEST_CLOCK = 0.05  # real-time factor below which a goal times out


@dataclass(frozen=True)
class Moved:
    """Result of a goal."""

    name: str  # of the move
    state: str  # of HandGoalStatus at the end
    error: float  # of the position, as estimated [m]
    time: float  # at the end [robot time, s]


def follow_plan(instance: Instance, plan: Plan, check: Callable[[], None], tell: Callable[[str], None]) -> list[Moved]:
    """Move the right hand through the goals of a plan, and release it.

    A goal that is not reached ends after its timeout. ``check`` may raise: the arm then holds its position. ``tell``
    receives each move's name. Raises ``ValorError``: a goal was rejected, or the hand released; it then retreats.
    """
    from std_msgs.msg import Empty

    from valor.valorctl.drive.ros_client import RosClient

    with RosClient(instance, check) as ros:
        hand = _Hand(ros, instance.settings().frame_prefix + ODOM)
        cancel = ros.publisher(Empty, CANCEL, 1)
        made = list[Moved]()
        try:
            free = plan.moves[0]
            for move in plan.moves:
                tell(move.name)
                made.append(hand.go(move))
                free = move if made[-1].state == REACHED else free
                if made[-1].state == RESISTED:
                    reason, blocked = hand.reason, False
                    for retreat in plan.retreat(free):
                        tell(retreat.name)
                        blocked = hand.go(retreat).state == RESISTED
                    where = "is still in contact" if blocked else "is back"
                    raise ValorError(f"{move.name}: {plan.resisted}: the hand was released: {reason}; it {where}")
        finally:
            cancel.publish(Empty())
        return made


class _Hand:
    def __init__(self, ros: Any, frame: str) -> None:
        from geometry_msgs.msg import PoseStamped
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from valor_msgs.msg import HandGoalStatus

        self._ros, self._frame, self._pose = ros, frame, PoseStamped
        self._status: Any = None  # latest; None: none since the latest goal
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        ros.subscribe(HandGoalStatus, STATUS, lambda message: setattr(self, "_status", message), latched)
        self._goal = ros.publisher(PoseStamped, GOAL, 1)

    def go(self, move: HandMove) -> Moved:
        """Send a goal and wait until it ends or times out."""
        message = self._pose()
        message.header.frame_id = self._frame
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = move.hand.position
        q.w, q.x, q.y, q.z = move.hand.orientation
        self._status = None
        sent = -math.inf

        def accepted() -> bool:
            nonlocal sent
            if self._state == "moving":
                return True
            if time.monotonic() - sent > _REPEAT_PERIOD:  # a discovered subscriber may not receive yet
                self._goal.publish(message)
                sent = time.monotonic()
            return False

        self._ros.wait(accepted, _ACCEPT_TIMEOUT, f"{move.name}: the goal of {HAND} is not accepted")
        began = self._status.time

        def over() -> bool:
            return self._state != "moving" or self._status.time - began > 1e9 * move.patience

        timeout = _ACCEPT_TIMEOUT + move.patience / _SLOWEST_CLOCK
        self._ros.wait(over, timeout, f"{move.name}: {HAND} still moves")
        if self._state == "idle":
            raise ValorError(f"{move.name}: {HAND} was released: {self.reason}")
        return Moved(move.name, self._state, float(self._status.position_error), 1e-9 * self._status.time)

    @property
    def reason(self) -> str:
        """Reason of the state."""
        return str(self._status.reason)

    @property
    def _state(self) -> str:
        return "" if self._status is None else str(self._status.state)


PROGRAM = "stand_and_reach.py"
PROGRAM_TIMEOUT = 300.0  # [s]
DISTANCE = 3.0  # from the level pad onto the dirt [m]
GROUP = "right_arm"  # reaches
POSTURES = {"forward": "forward", "aside": "side"}  # of the client → presets
FINGER_SPEED, FINGER_TOLERANCE = 0.5, 0.2  # share of the speed limits; [rad]
TRUTH_TIMEOUT = 5.0  # [s]


def require_arm(context: Context) -> None:
    """Require the arm that reaches."""
    arm_motion.require_limbs(context.robot, "demo (`demo walk` walks only)", GROUP)


def reach(context: Context) -> None:
    """Run the ROS client of the examples as a user would: with the instance's environment."""
    words = [example_file(PROGRAM), "--json", context.report, *_postures(context)]
    # In its own session: Ctrl-C reaches only this process, which then ends the client.
    environment = os.environ | context.instance.environment()
    client = subprocess.Popen([sys.executable, *map(str, words)], env=environment, start_new_session=True)
    deadline = time.monotonic() + PROGRAM_TIMEOUT
    try:
        while client.poll() is None:
            context.interruption.check()
            if time.monotonic() > deadline:
                raise ValorError(f"{PROGRAM}: still running after {PROGRAM_TIMEOUT:g} s")
            time.sleep(0.05)
    finally:
        client.terminate()
        try:
            client.wait(5.0)
        except subprocess.TimeoutExpired:
            client.kill()
            client.wait()
    if client.returncode:
        raise ValorError(f"{PROGRAM} failed with exit status {client.returncode}")


def _postures(context: Context) -> list[str | Path]:
    """Arguments with the robot's own postures, for robots whose joint names differ from ESCHER's."""
    presets = context.robot.tables.arm_presets
    postures = {key: presets[name]["right"] for key, name in POSTURES.items() if "right" in presets.get(name, {})}
    if len(postures) < len(POSTURES):
        return []
    file = context.options.out / "demo_postures.json"
    file.write_text(json.dumps(postures, indent=2) + "\n")
    return ["--postures", file]


def walk_onto_the_dirt(context: Context) -> None:
    """Walk off the level pad."""
    context.walk(WalkRequest(forward=speed(context.robot), distance=DISTANCE, straight=True))


def reach_pictures(context: Context) -> Sequence[Picture]:
    """Pictures of ``demo``."""
    from valor.analysis.reading.bag import Bag
    from valor.analysis.robot import before_after, tracking_plots
    from valor.analysis.walk import walk_plots

    recording, robot, out = Bag.of(context.bag), context.robot, context.options.out
    return [
        ("the robot before and after reaching", partial(before_after.render_before_after, recording, robot, out)),
        ("the robot on its way", partial(walk_plots.picture, recording, robot, out)),
        ("the arm's tracking", partial(tracking_plots.joint_tracking, recording, robot, (GROUP,), out)),
        ("the balance", partial(walk_plots.dynamics, recording, robot, out)),
    ]


def _course_request(context: Context) -> WalkRequest:
    options = context.options
    distance = course() if options.distance is None else options.distance
    forward = speed(context.robot) if options.speed is None else options.speed
    return WalkRequest(forward=forward, distance=distance, straight=True)


def walk_the_course(context: Context) -> None:
    """Walk the requested distance; to the finish line by default."""
    context.walk(_course_request(context))


def course_pictures(context: Context) -> Sequence[Picture]:
    """Write and print the metrics of the walk, from the bag; returns its pictures."""
    from valor.analysis.reading.bag import Bag
    from valor.analysis.reading.recording import Recording
    from valor.analysis.walk import walk_plots
    from valor.analysis.walk.track import Timeliness, Track, WalkMetrics, named, rows

    context.progress.waiting("reading the bag")
    bag = Bag.of(context.bag)
    recording = Recording(bag, context.robot)
    track = Track.of(recording)
    track = track.between(*track.walk())
    figures = WalkMetrics.of(track)
    timeliness = Timeliness.of(recording, track)
    totals = {"distance_m": figures.distance, "duration_s": figures.duration, "fell": figures.fell}
    context.report.write_text(json.dumps(totals | named(figures, timeliness), indent=2) + "\n")
    context.progress.clear()
    say_rows(
        [
            ("distance", f"{figures.distance:.1f} m"),
            ("robot time", f"{figures.duration:.1f} s ({figures.speed:.2f} m/s)"),
            ("falls", str(int(figures.fell))),
            *rows(figures, timeliness),
        ]
    )
    return [
        (f"the {draw.__name__}", partial(draw, bag, context.robot, context.options.out))
        for draw in (walk_plots.path, walk_plots.dynamics, walk_plots.picture)
    ]


def require_task(name: str, context: Context) -> None:
    """Require what a manipulation needs: steps, the right hand and a long enough arm."""
    TASKS[name].plan(context.robot, context.options.seed)


def manipulate(name: str, context: Context) -> None:
    """Walk up to a fixture, move it with the right hand, and require enough motion in the simulator."""
    instance, check, task = context.instance, context.interruption.check, TASKS[name]
    seed = context.options.seed
    plan = task.plan(context.robot, seed)
    context.progress.waiting("walking up")
    result = stepping.step_to(instance, plan.stance, relative=False, check=check)
    if result.reason:
        raise ValorError(f"walking up: {result.reason}")
    context.progress.done(result.describe())
    control_mode.enter(instance, ControlMode.STAND_MANIPULATE, check)
    arm_motion.move_limb(
        instance, "right", "hand", plan.fingers, speed=FINGER_SPEED, tolerance=FINGER_TOLERANCE, check=check
    )
    moves = follow_plan(instance, plan, check, context.progress.waiting)
    with join(instance) as node:
        truth = next_message(GROUND_TRUTH, GROUND_TRUTH.subscriber(node), TRUTH_TIMEOUT)
    turned = math.degrees(float(truth.fixture_position[0]))
    report = {"task": name, "seed": seed, "turned_deg": turned, "moves": [asdict(move) for move in moves]}
    context.report.write_text(json.dumps(report, indent=2) + "\n")
    result_text = f"the {task.fixture} has been turned by {turned:.0f}°"
    if turned < math.degrees(task.enough):
        raise ValorError(f"{result_text}; expected at least {math.degrees(task.enough):.0f}°")
    context.progress.done(result_text)


def _task_demo(name: str) -> Demo:
    return Demo(
        world=name,
        blocked_world=TASKS[name].blocked,
        files=(f"{name}.mcap", f"{name}.json"),
        check=partial(require_task, name),
        steps=(partial(manipulate, name),),
    )


DEMOS = {  # by the names of their instances
    "demo": Demo(
        world=WORLD,
        files=("demo.mcap", "demo.json"),
        check=require_arm,
        steps=(reach, walk_onto_the_dirt),
        pictures=reach_pictures,
        suggestions=(
            ("demo walk", f"the complete course, {course():.0f} m"),
            ("up", "a robot that stands until `down`"),
            ("walk --vx 0.3 --for 10", "walks"),
        ),
    ),
    "demo-walk": Demo(
        world=WORLD,
        files=("walk.mcap", "walk.json"),
        check=_course_request,
        steps=(walk_the_course,),
        pictures=course_pictures,
    ),
    **{f"demo-{name}": _task_demo(name) for name in TASKS},
}
