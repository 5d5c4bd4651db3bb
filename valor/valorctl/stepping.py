"""Footsteps from the command line: an ordinary client of the footstep action, that knows ROS names alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from valor.common.behaviors import STEPPING_MODES, ControlMode
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.poses import Pose, middle
from valor.common.transforms import TransformBuffer, TransformError
from valor.robot.description import RobotDescription
from valor.robot.step_plan import FEET, START, PlanStep
from valor.robot.step_planner import Middle, plan_to
from valor.valorctl import control_mode

ACTION = "robot_controllers/footstep_controller/execute_step_plan"
ODOM = "odom"

_TF_TIMEOUT = 10.0  # until the soles are known [s]
_SLOWEST_CLOCK = 0.1  # real-time factor below which a plan is given up
_STEP_DURATION = 6.0  # no step takes longer, with the weight's transfer [robot time, s]


@dataclass(frozen=True)
class Outcome:
    """What became of a plan, as the robot itself believes.

    Attributes:
        start: left and right sole before, in odom.
        steps: foot and sole of each step, in odom.
        end: left and right sole after.
        flags: of FootstepExecutionStatus.
        reason: why it did not reach its end, or an empty text.
    """

    start: tuple[Pose, Pose]
    steps: list[tuple[int, Pose]]
    end: tuple[Pose, Pose]
    flags: int
    reason: str

    @property
    def errors(self) -> tuple[float, float]:
        """Largest distance [m] and turn [rad] of a sole from its last step; without one, from the start."""
        wanted = dict([*enumerate(self.start), *self.steps])
        far = max(math.dist(self.end[foot].position, pose.position) for foot, pose in wanted.items())
        turned = max(abs(math.remainder(self.end[foot].yaw - pose.yaw, math.tau)) for foot, pose in wanted.items())
        return far, turned

    def describe(self) -> str:
        """One line."""
        far, turned = self.errors
        return (
            f"{len(self.steps)} steps; the feet stand at most {far * 100:.1f} cm and {math.degrees(turned):.1f}° "
            "from the plan"
        )


def intention(steps: Sequence[PlanStep], goal: Middle, *, relative: bool) -> str:
    """What is about to be done, in one line.

    Args:
        steps: that lead there.
        goal: x, y [m], yaw [rad] of the middle of the feet as seen from where it is.
        relative: whether it was asked for so, and not in odom.
    """
    x, y, yaw = goal
    ways = ((x, "ahead", "back"), (y, "to the left", "to the right"))
    parts = [f"{abs(way):.2f} m {more if way > 0.0 else less}" for way, more, less in ways if abs(way) > 0.005]
    turn = math.degrees(math.remainder(yaw, math.tau))
    if abs(turn) > 0.5:
        parts.append(f"{abs(turn):.0f}° {'left' if turn > 0.0 else 'right'}")
    seen = "from where the robot stands" if relative else "from here to the place in odom; --relative is from here"
    return f"{len(steps)} steps: {', '.join(parts) or 'on the spot'} ({seen})"


def step_to(
    instance: Instance,
    goal: Middle,
    *,
    relative: bool,
    check: Callable[[], None],
    tell: Callable[[str], None] = lambda text: None,
) -> Outcome:
    """Step until the middle of the feet is at a goal.

    Args:
        instance: a running system.
        goal: x, y [m], yaw [rad]; in odom, or as seen from where the middle of the feet is.
        relative: whether it is the latter.
        check: raises when the user wants to stop; the plan is then canceled.
        tell: is told what is about to be done.

    Raises:
        ValorError: too far, mode refused, or nobody answers.
    """

    def steps(start: tuple[Pose, Pose], robot: RobotDescription) -> Sequence[PlanStep]:
        here = middle(*start)
        there = goal
        if not relative and all(map(math.isfinite, goal)):
            dx, dy = goal[0] - here.position[0], goal[1] - here.position[1]
            c, s = math.cos(here.yaw), math.sin(here.yaw)
            there = (c * dx + s * dy, c * dy - s * dx, goal[2] - here.yaw)
        if robot.tables.footsteps is None:
            raise ValorError(f"robot {robot.name!r} takes no footstep plans: its robot.yaml has no footsteps")
        made = plan_to(there, robot.tables.footsteps, robot.tables.walking)
        if not made:
            raise ValorError("the feet are there already")
        tell(intention(made, there, relative=relative))
        return made

    return _run(instance, steps, START, check)


def step_plan(instance: Instance, steps: Sequence[PlanStep], frame: str, check: Callable[[], None]) -> Outcome:
    """Take the steps of a plan in a frame of tf, or in `feet`, the middle of the feet as they stand.

    Raises:
        ValorError: mode refused, unknown frame, or nobody answers.
    """
    return _run(instance, lambda _start, _robot: steps, frame, check)


def _run(
    instance: Instance,
    make: Callable[[tuple[Pose, Pose], RobotDescription], Sequence[PlanStep]],
    frame: str,
    check: Callable[[], None],
) -> Outcome:
    from valor.valorctl.ros_client import RosClient

    robot = RobotDescription.load(instance.settings().robot)
    with RosClient(instance, check) as ros:
        tf = _Tf(ros, robot, instance.settings().frame_prefix)
        start = tf.soles()
        steps = make(start, robot)
        to_odom = middle(*start) if frame == START else tf.frame(frame)
        planned = [(FEET.index(step.foot), to_odom @ step.sole) for step in steps]
        before = control_mode.report(instance).current_control_mode
        if before not in STEPPING_MODES:
            control_mode.enter(instance, ControlMode.STEP, check)
        flags, reason = _execute(ros, tf.odom, steps, planned)
        if reason == "" and before not in STEPPING_MODES and before != ControlMode.STAND:
            control_mode.enter(instance, before, check)
        tf.forget()
        return Outcome(start, planned, tf.soles(), flags, reason)


def _execute(ros: Any, frame: str, steps: Sequence[PlanStep], planned: Sequence[tuple[int, Pose]]) -> tuple[int, str]:
    """Flags of the result, and why it is not the goal reached; ``frame``: odom, as tf names it."""
    from vigir_footstep_planning_msgs.action import ExecuteStepPlan
    from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus, Step

    goal = ExecuteStepPlan.Goal()
    goal.step_plan.header.frame_id = frame
    for index, (step, (foot, sole)) in enumerate(zip(steps, planned, strict=True)):
        message = Step(step_index=index, valid=True)
        message.foot.foot_index = foot
        p, q = message.foot.pose.position, message.foot.pose.orientation
        p.x, p.y, p.z = sole.position
        q.w, q.x, q.y, q.z = sole.orientation
        message.swing_height, message.step_duration = step.swing_height, step.step_duration
        message.sway_duration = step.sway_duration
        goal.step_plan.steps.append(message)
    texts: list[str] = []
    timeout = (len(steps) + 2) * _STEP_DURATION / _SLOWEST_CLOCK
    result = ros.call_action(
        ExecuteStepPlan, ACTION, goal, timeout, lambda feedback: texts.append(feedback.status.error_msg)
    )
    flags = int(result.status.status)
    if flags & FootstepExecutionStatus.REACHED_GOAL:
        return flags, ""
    return flags, next((text for text in reversed(texts) if text), "") or f"status {flags}, without a word"


class _Tf:
    """Where frames are, by ROS.

    Attributes:
        odom: as tf names it.
    """

    def __init__(self, ros: Any, robot: RobotDescription, prefix: str) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from tf2_msgs.msg import TFMessage

        self._ros = ros
        feet = robot.tables.feet
        self._prefix, self.odom = prefix, prefix + ODOM
        self._soles = tuple(prefix + robot.frame_of(foot.sole) for foot in (feet.left, feet.right))
        self._buffer = TransformBuffer()
        self._heard = 0
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        ros.subscribe(TFMessage, "/tf", lambda message: self._hear(message, static=False), 1)
        ros.subscribe(TFMessage, "/tf_static", lambda message: self._hear(message, static=True), latched)

    def _hear(self, message: Any, *, static: bool) -> None:
        self._heard += not static
        for each in message.transforms:
            t, r, stamp = each.transform.translation, each.transform.rotation, each.header.stamp
            pose = Pose((t.x, t.y, t.z), (r.w, r.x, r.y, r.z))
            time = stamp.sec * 10**9 + stamp.nanosec
            self._buffer.add(each.header.frame_id, each.child_frame_id, time, pose, static=static)

    def forget(self) -> None:
        """What comes next is looked at, not what has come while nobody looked."""
        heard = self._heard
        self._ros.wait(lambda: self._heard > heard + 2, _TF_TIMEOUT, "no /tf from valor_ros_controller")

    def frame(self, name: str) -> Pose:
        """A frame in odom now.

        Raises:
            ValorError: tf does not know it.
        """
        if name in (ODOM, self.odom):
            return Pose()
        try:
            return self._buffer.lookup(self.odom, self._prefix + name)
        except TransformError:
            if not self._prefix:
                raise
        return self._buffer.lookup(self.odom, name)  # one that is not the robot's

    def soles(self) -> tuple[Pose, Pose]:
        """Left and right in odom now."""

        def known() -> bool:
            try:
                for name in self._soles:
                    self._buffer.lookup(self.odom, name)
            except TransformError:
                return False
            return True

        self._ros.wait(known, _TF_TIMEOUT, f"tf does not know {' and '.join(self._soles)} in {self.odom}")
        left, right = (self._buffer.lookup(self.odom, name) for name in self._soles)
        return left, right
