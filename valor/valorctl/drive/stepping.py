"""`step`: a ROS client of the footstep action."""

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
from valor.robot.step_plan import FEET, START, Middle, PlanStep, plan_to
from valor.valorctl.drive import control_mode

ACTION = "robot_controllers/footstep_controller/execute_step_plan"
ODOM = "odom"

_TF_TIMEOUT = 10.0  # of the soles' transforms [s]
_SLOWEST_CLOCK = 0.1  # real-time factor below which a plan times out
_STEP_DURATION = 6.0  # of a step with its transfer, at most [robot time, s]


@dataclass(frozen=True)
class SteppingResult:
    """Result of a plan, as estimated by the robot."""

    steps: int
    distance: float  # largest one of a sole from its last step, or from its start without one [m]
    angle: float  # largest difference of heading from it [rad]
    flags: int  # of FootstepExecutionStatus
    reason: str  # why the plan was not completed; empty if it was

    def describe(self) -> str:
        """One line."""
        return (
            f"{self.steps} steps; the feet stand at most {self.distance * 100:.1f} cm and "
            f"{math.degrees(self.angle):.1f}° from the plan"
        )


def step_to(instance: Instance, goal: Middle, *, relative: bool, check: Callable[[], None]) -> SteppingResult:
    """Step until the middle of the feet is at a goal x, y [m], yaw [rad], in odom or relative to it.

    An exception of ``check`` cancels the plan. Raises ``ValorError``: goal too far, mode rejected, or no response.
    """

    def steps(here: Pose, robot: RobotDescription) -> Sequence[PlanStep]:
        there = goal
        if not relative and all(map(math.isfinite, goal)):
            dx, dy = goal[0] - here.position[0], goal[1] - here.position[1]
            c, s = math.cos(here.yaw), math.sin(here.yaw)
            there = (c * dx + s * dy, c * dy - s * dx, goal[2] - here.yaw)
        if robot.tables.footsteps is None:
            raise ValorError(f"robot {robot.name!r} takes no footstep plans: its robot.yaml has no footsteps")
        made = plan_to(there, robot.tables.footsteps, robot.tables.walking)
        if not made:
            raise ValorError("the feet are at the goal; expected another one")
        return made

    return _run(instance, steps, START, check)


def step_plan(instance: Instance, steps: Sequence[PlanStep], frame: str, check: Callable[[], None]) -> SteppingResult:
    """Take the steps of a plan in a frame of tf, or in `feet`, their present middle; errors as of ``step_to``."""
    return _run(instance, lambda _here, _robot: steps, frame, check)


def _run(
    instance: Instance,
    make: Callable[[Pose, RobotDescription], Sequence[PlanStep]],
    frame: str,
    check: Callable[[], None],
) -> SteppingResult:
    """``make`` receives the middle of the feet in odom, and returns the steps in ``frame``."""
    from valor.valorctl.drive.ros_client import RosClient

    robot = RobotDescription.load(instance.settings().robot)
    with RosClient(instance, check) as ros:
        tf = _Tf(ros, robot, instance.settings().frame_prefix)
        start = tf.soles()
        steps = make(middle(*start), robot)
        to_odom = middle(*start) if frame == START else tf.frame(frame)
        planned = [(FEET.index(step.foot), to_odom @ step.sole) for step in steps]
        before = control_mode.report(instance).current_control_mode
        if before not in STEPPING_MODES:
            control_mode.enter(instance, ControlMode.STEP, check)
        flags, reason = _execute(ros, tf.odom, steps, planned)
        if reason == "" and before not in STEPPING_MODES and before != ControlMode.STAND:
            control_mode.enter(instance, before, check)
        end = tf.soles()
    wanted = dict([*enumerate(start), *planned])
    distance = max(math.dist(end[foot].position, pose.position) for foot, pose in wanted.items())
    angle = max(abs(math.remainder(end[foot].yaw - pose.yaw, math.tau)) for foot, pose in wanted.items())
    return SteppingResult(len(steps), distance, angle, flags, reason)


def _execute(ros: Any, frame: str, steps: Sequence[PlanStep], planned: Sequence[tuple[int, Pose]]) -> tuple[int, str]:
    """Execute the plan; returns the status flags, and why it was not completed. ``frame``: odom, as named in tf."""
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
    return flags, next((text for text in reversed(texts) if text), f"status {flags}, without a reason")


class _Tf:
    """Transforms from tf; ``odom``: name of the frame, with the prefix."""

    def __init__(self, ros: Any, robot: RobotDescription, prefix: str) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from tf2_msgs.msg import TFMessage

        self._ros = ros
        feet = robot.tables.feet
        self._prefix, self.odom = prefix, prefix + ODOM
        self._soles = tuple(prefix + robot.frame_of(foot.sole) for foot in (feet.left, feet.right))
        self._buffer = TransformBuffer()
        self._received = 0  # messages on /tf
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        ros.subscribe(TFMessage, "/tf", lambda message: self._store(message, static=False), 1)
        ros.subscribe(TFMessage, "/tf_static", lambda message: self._store(message, static=True), latched)

    def _store(self, message: Any, *, static: bool) -> None:
        self._received += not static
        for each in message.transforms:
            t, r, stamp = each.transform.translation, each.transform.rotation, each.header.stamp
            pose = Pose((t.x, t.y, t.z), (r.w, r.x, r.y, r.z))
            time = stamp.sec * 10**9 + stamp.nanosec
            self._buffer.add(each.header.frame_id, each.child_frame_id, time, pose, static=static)

    def frame(self, name: str) -> Pose:
        """Pose of a frame in odom; raises ``ValorError`` if tf has none."""
        if name in (ODOM, self.odom):
            return Pose()
        try:
            return self._buffer.lookup(self.odom, self._prefix + name)
        except TransformError:
            return self._buffer.lookup(self.odom, name)  # without the prefix: not a frame of the robot

    def soles(self) -> tuple[Pose, Pose]:
        """Left and right sole in odom, from new transforms."""
        found: list[Pose] = []
        before = self._received

        def known() -> bool:
            try:
                found[:] = [self._buffer.lookup(self.odom, name) for name in self._soles]
            except TransformError:
                return False
            return self._received > before + 2

        self._ros.wait(known, _TF_TIMEOUT, f"no {' and '.join(self._soles)} in {self.odom} from tf")
        return found[0], found[1]
