"""From a planner's plan to feet on the ground: the whole way through real processes, plant and model different.

The client is an ordinary ROS 2 node; a foot's place is tf's. The simulator's truth is looked at here alone.
"""

from __future__ import annotations

import math
import shutil
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from tf2_msgs.msg import TFMessage
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus, Step, StepPlan

import bifrost
from tests.conftest import REPOSITORY, ROBOTS, RunningInstance, wait_until
from tests.system import RosClient
from valor_common.instance import Instance, Settings
from valor_common.messages import GroundTruth, MotionState, PushReply, PushRequest, StepStatus
from valor_common.model import full_model
from valor_common.poses import Pose, level
from valor_common.robot import RobotDescription
from valor_common.topics import GROUND_TRUTH, MOTION_STATE, PUSH, STEP_STATUS
from valor_common.transforms import TransformBuffer, TransformError
from valorctl.step_plan import FEET, PlanStep, load
from valorctl.step_planner import middle

S = FootstepExecutionStatus
PLANS = REPOSITORY / "examples" / "plans"
ACTION = "/robot_controllers/footstep_controller/execute_step_plan"
FEEDBACK = "/robot_controllers/footstep_controller/execute_feedback"
ROBOT = RobotDescription.load(ROBOTS / "escher")
PROCESSES = ("bifrostd", "comms_manager", "motion_manager", "valor_ros_controller", "footstep_converter")
LIMIT = 120.0  # for anything to happen on a loaded machine that the robot has no part in [s]
PATIENCE = 60.0  # for what the robot does [robot time, s]
FAR, TURNED = 0.03, math.radians(3.0)  # a foot may end so far from the plan, as the robot believes
TRULY = 2.0  # so many times as far in truth: odometry drifts
EXTERNAL_CHANGE = 32
pytestmark = pytest.mark.timeout(900)

Soles = tuple[Pose, Pose]  # left, right


@dataclass
class Goal:
    """A goal sent, and what has been heard of it."""

    handle: Any = None
    feedback: list[tuple[float, Any]] = field(default_factory=list)  # with the time of arrival [s]
    result: Any = None
    text: str = ""  # the last words, once the outcome is known

    @property
    def executing(self) -> int:
        """Index of the step under way."""
        return int(self.feedback[-1][1].currently_executing_step_index) if self.feedback else -1

    @property
    def active(self) -> list[tuple[float, Any]]:
        """Feedback while the robot had the plan."""
        return [each for each in self.feedback if each[1].controller_state == ExecuteStepPlan.Feedback.ACTIVE]


class Walker:
    """A system with a robot in it, a planner's client and an observer."""

    def __init__(self, instance: RunningInstance, ros: RosClient) -> None:
        self.instance = instance
        self._ros = ros
        self._action = ActionClient(ros.node, ExecuteStepPlan, ACTION)
        self._tf = TransformBuffer()
        self._newest: deque[bytes] = deque(maxlen=5)  # of /tf, to be read when somebody asks
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        # A client of an action forgets a goal with its result: feedback that comes behind is for the topic's listeners.
        self._words: list[Any] = []
        ros.node.create_subscription(ExecuteStepPlan.Feedback, FEEDBACK, self._listen, latched)
        ros.node.create_subscription(TFMessage, "/tf", self._keep, 10, raw=True)
        ros.node.create_subscription(TFMessage, "/tf_static", lambda m: self._hear(m, static=True), latched)
        node = instance.node("observer")
        self._truth = node.subscriber(GROUND_TRUTH.name, GroundTruth)
        self._states = node.subscriber(MOTION_STATE.name, MotionState)
        self._statuses = node.subscriber(STEP_STATUS.name, StepStatus, queue=1000)
        self._push = node.client(PUSH.name, PushRequest, PushReply)
        self.statuses: list[StepStatus] = []
        self._model = full_model(ROBOT)
        assert self._action.wait_for_server(LIMIT)

    def _listen(self, feedback: Any) -> None:
        self._words.append(feedback)

    def _keep(self, data: bytes) -> None:
        self._newest.append(data)

    def _hear(self, message: Any, *, static: bool) -> None:
        for each in message.transforms:
            t, r, stamp = each.transform.translation, each.transform.rotation, each.header.stamp
            pose, at = Pose((t.x, t.y, t.z), (r.w, r.x, r.y, r.z)), stamp.sec * 10**9 + stamp.nanosec
            self._tf.add(each.header.frame_id, each.child_frame_id, at, pose, static=static)

    # --- the robot ------------------------------------------------------------------------------------------------

    def state(self) -> MotionState:
        return wait_until(self._states.latest, LIMIT, MOTION_STATE.name).message

    def wait(self, condition: Callable[[], object], what: str, period: float = 0.02) -> None:
        """Wait as long as the robot needs, however slowly its time goes by."""
        until = self.state().time + round(PATIENCE * 1e9)

        def over() -> bool:
            assert self.state().time < until, f"not within {PATIENCE:g} s of robot time: {what}"
            return bool(condition())

        wait_until(over, 10.0 * LIMIT, what, period)

    def rest(self) -> None:
        """Wait until the robot stands still on both feet."""

        def still() -> bool:
            state = self.state()
            return bool(state.contacts.all() and np.abs(state.pelvis_linear_velocity_in_odom).max() < 0.01)

        self.wait(still, "the robot at rest")

    def soles(self) -> Soles:
        """Where they are in odom, by a tf that comes from now on."""

        def look() -> Soles | None:
            for data in self._newest:
                self._hear(deserialize_message(data, TFMessage), static=False)
            try:
                return self._tf.lookup("odom", "l_sole"), self._tf.lookup("odom", "r_sole")
            except TransformError:
                return None

        self._newest.clear()
        wait_until(lambda: len(self._newest) > 2, LIMIT, "tf")
        return wait_until(lambda: self._ros._call(look), LIMIT, "the soles in tf")

    def true_soles(self) -> Soles:
        """Where they are in the world."""
        self._truth.latest()
        truth = wait_until(self._truth.latest, LIMIT, GROUND_TRUTH.name).message
        model, data, feet = self._model, mujoco.MjData(self._model.mj), ROBOT.tables.feet
        data.qpos[:3] = truth.pelvis_position_in_world
        data.qpos[3:7] = truth.pelvis_orientation_in_world
        data.qpos[model.qpos] = truth.joint_position
        mujoco.mj_kinematics(model.mj, data)

        def pose(name: str) -> Pose:
            orientation = np.empty(4)
            mujoco.mju_mat2Quat(orientation, data.site(name).xmat)
            x, y, z = map(float, data.site(name).xpos)
            qw, qx, qy, qz = map(float, orientation)
            return Pose((x, y, z), (qw, qx, qy, qz))

        return pose(feet.left.sole), pose(feet.right.sole)

    def push(self, impulse: tuple[float, float, float]) -> None:
        assert self._push.call(PushRequest(impulse_in_world=np.array(impulse), duration=0.1), timeout=10.0).accepted

    def status(self) -> list[StepStatus]:
        """All that has been said of steps."""
        self.statuses += [received.message for received in self._statuses.drain()]
        return self.statuses

    # --- the client -----------------------------------------------------------------------------------------------

    def mode(self, name: str) -> None:
        """Be in a control mode."""
        wait_until(lambda: self._ros.change_mode(name, LIMIT).current_control_mode == name, LIMIT, f"mode {name}", 0.2)

    @property
    def report(self) -> Any:
        """The VRC's newest."""
        return self._ros.reports[-1][1]

    def send(self, plan: StepPlan) -> Goal:
        goal = Goal()
        self._words.clear()
        future = self._ros._call(
            self._action.send_goal_async,
            ExecuteStepPlan.Goal(step_plan=plan),
            lambda message: goal.feedback.append((time.monotonic(), message.feedback)),
        )
        goal.handle = self._ros._wait(future, LIMIT, "the goal's response")
        ended = self._ros._call(goal.handle.get_result_async)
        ended.add_done_callback(lambda done: setattr(goal, "result", done.result()))
        return goal

    def cancel(self, goal: Goal) -> None:
        self._ros._call(goal.handle.cancel_goal_async)

    def outcome(self, goal: Goal) -> tuple[int, int]:
        """Terminal state and flags."""
        self.wait(lambda: goal.result, "the goal's result")
        flags = int(goal.result.result.status.status)

        def last_words() -> Any:
            heard = [*(words for _, words in goal.feedback), *self._words]
            return next((words for words in reversed(heard) if words.stepping_status == flags), None)

        goal.text = wait_until(last_words, LIMIT, "the last words").status.error_msg
        return goal.result.status, flags


def message(planned: Sequence[tuple[int, Pose]], steps: Sequence[PlanStep], first: int = 0) -> StepPlan:
    """A plan in odom."""
    plan = StepPlan()
    plan.header.frame_id = "odom"
    for index, (step, (foot, sole)) in enumerate(zip(steps, planned, strict=True), first):
        made = Step(step_index=index, valid=True, swing_height=step.swing_height)
        made.step_duration, made.sway_duration = step.step_duration, step.sway_duration
        made.foot.foot_index = foot
        p, q = made.foot.pose.position, made.foot.pose.orientation
        p.x, p.y, p.z = sole.position
        q.w, q.x, q.y, q.z = sole.orientation
        plan.steps.append(made)
    return plan


def put(steps: Sequence[PlanStep], frame: Pose) -> list[tuple[int, Pose]]:
    """Foot and sole of each step, in the frame that ``frame`` is in."""
    return [(FEET.index(step.foot), frame @ step.sole) for step in steps]


def ahead(count: int, length: float = 0.2, duration: float = 0.0) -> list[PlanStep]:
    """Steps straight ahead, the feet side by side in the end."""
    xs = [length * (i + 1) for i in range(count - 1)]
    return [
        PlanStep(foot=FEET[i % 2], x=x, y=0.1 - 0.2 * (i % 2), step_duration=duration)  # type: ignore[arg-type]
        for i, x in enumerate([*xs, xs[-1]])
    ]


def pose_of(step: Step) -> Pose:
    p, q = step.foot.pose.position, step.foot.pose.orientation
    return Pose((p.x, p.y, p.z), (q.w, q.x, q.y, q.z))


def check(
    believed: Soles, wanted: dict[int, Pose], note: Callable[[str, object], None], true: Soles, to_world: Pose
) -> None:
    """Where the feet stand against where they should, by the robot's belief and in truth.

    Args:
        believed: in odom.
        wanted: of each foot, in odom.
        note: keeps a number for the record.
        true: in world.
        to_world: odom in world, as the feet stood before.
    """

    def error(sole: Pose, place: Pose) -> tuple[float, float]:
        return math.dist(sole.position, place.position), abs(math.remainder(sole.yaw - place.yaw, math.tau))

    for foot, place in wanted.items():
        for how, (far, turned), most in (
            ("believed", error(believed[foot], place), 1.0),
            ("true", error(true[foot], to_world @ place), TRULY),
        ):
            note(f"{FEET[foot]}_{how}", f"{far * 100:.1f} cm, {math.degrees(turned):.1f}°")
            print(f"{FEET[foot]} foot, {how}: {far * 100:.1f} cm, {math.degrees(turned):.1f}°")
            assert far < most * FAR, f"the {FEET[foot]} foot, {how}"
            assert turned < most * TURNED, f"the {FEET[foot]} foot, {how}"


@contextmanager
def system(name: str, domain: int, **settings: object) -> Iterator[Walker]:
    """All processes but the recorder, free-running, the robot standing."""
    home = Path(tempfile.mkdtemp(prefix="valor-"))
    made = Instance(name, home)
    made.logs.mkdir(parents=True)
    made.bags.mkdir()
    made.settings_file.write_text(
        Settings(
            robot=ROBOTS / "escher", ros_domain_id=domain, real_time_factor=0.0, **settings  # type: ignore[arg-type]
        ).model_dump_json()
    )  # fmt: skip
    instance = RunningInstance(made, bifrost.Network.create(made.network_file, made.keys))
    ros = None
    try:
        for process in PROCESSES:
            instance.start(process)
            if process != "bifrostd":
                instance.wait_ready(process, LIMIT)
        ros = RosClient(instance.environment)
        walker = Walker(instance, ros)
        walker.mode("stand")
        walker.rest()
        yield walker
    finally:
        if ros is not None:
            ros.close()
        instance.close()
        shutil.rmtree(home, ignore_errors=True)


@pytest.fixture(scope="module")
def flat() -> Iterator[Walker]:
    with system("steps", 166, seed=1) as walker:
        yield walker


@pytest.fixture
def walker(flat: Walker) -> Walker:
    """Ready to take a plan."""
    flat.mode("step")
    flat.rest()
    return flat


def test_a_figure_of_eight(walker: Walker, record_property: Callable[[str, object], None]) -> None:
    steps = load(PLANS / "figure_of_eight.yaml").steps
    assert len(steps) == 20
    before, truly = walker.soles(), walker.true_soles()
    to_world = middle(*truly) @ middle(*before).inverse()
    planned = put(steps, middle(*before))
    goal = walker.send(message(planned, steps))
    assert walker.outcome(goal) == (GoalStatus.STATUS_SUCCEEDED, S.REACHED_GOAL)
    wait_until(lambda: walker.report.current_control_mode == "stand", LIMIT, "mode stand after the plan")
    assert walker.report.status & EXTERNAL_CHANGE
    walker.rest()
    check(walker.soles(), dict(planned), record_property, walker.true_soles(), to_world)

    heard = [each for _, each in goal.active]
    indices = [
        (f.last_performed_step_index, f.currently_executing_step_index, f.first_changeable_step_index) for f in heard
    ]
    assert all(performed <= executing < changeable for performed, executing, changeable in indices)
    for one, other in pairwise(indices):
        assert all(a <= b for a, b in zip(one, other, strict=True))
    assert {executing for _, executing, _ in indices} >= set(range(20)), "feedback of every step"
    times = [at for at, _ in goal.active]
    assert 5.0 < (len(times) - 1) / (times[-1] - times[0]) < 11.0  # ten a second [Hz]


def test_an_update_in_mid_walk(walker: Walker, record_property: Callable[[str, object], None]) -> None:
    """The planner has drifted, and wants to go elsewhere; two updates before it are none."""
    before, truly = walker.soles(), walker.true_soles()
    to_world = middle(*truly) @ middle(*before).inverse()
    steps = ahead(8)
    planned = put(steps, middle(*before))
    goal = walker.send(message(planned, steps))
    walker.wait(lambda: goal.executing >= 1, "step 1")
    late = message(planned, steps)
    late.steps = late.steps[7:]
    late.steps[0].step_index = 10
    assert walker.outcome(walker.send(late)) == (GoalStatus.STATUS_ABORTED, S.ERR_INVALID_INCONSISTENT_INDICES)
    wrong = message([(1 - foot, sole) for foot, sole in planned], steps)
    assert walker.outcome(walker.send(wrong))[1] & (S.ERR_INCONSISTENT_STEP_PLAN | S.ERR_INVALID_PLAN)
    assert goal.result is None

    drift, path = level(0.05, -0.03, 0.0, 0.1), ahead(10, length=0.15)
    update = walker.send(message([(foot, drift @ sole) for foot, sole in put(path, middle(*before))], path))
    assert walker.outcome(goal) == (GoalStatus.STATUS_ABORTED, S.UPDATED_STEP_PLAN)
    first = int(goal.text.split("from step ")[1].split()[0])  # a newer plan took over from step … on
    assert first >= 2
    assert walker.outcome(update) == (GoalStatus.STATUS_SUCCEEDED, S.REACHED_GOAL)
    walker.rest()
    merged = [(step.foot.foot_index, pose_of(step)) for step in update.active[-1][1].feedback.steps]
    assert len(merged) == len(path)
    for (foot, sole), (other, place) in zip(merged[: first + 1], planned[: first + 1], strict=True):
        assert foot == other
        assert math.dist(sole.position, place.position) < 1e-9, "steps that cannot be changed, and the one in common"
    asked = put(path, Pose())
    for k in range(first + 1, len(path)):  # the rest is moved rigidly
        (_, one), (_, other), (_, a), (_, b) = merged[k - 1], merged[k], asked[k - 1], asked[k]
        assert math.dist((one.inverse() @ other).position, (a.inverse() @ b).position) < 1e-9
    check(walker.soles(), dict(merged), record_property, walker.true_soles(), to_world)


def test_a_cancel_in_mid_swing(walker: Walker, record_property: Callable[[str, object], None]) -> None:
    before, truly = walker.soles(), walker.true_soles()
    to_world = middle(*truly) @ middle(*before).inverse()
    steps = ahead(8, duration=1.2)
    planned = put(steps, middle(*before))
    walker.status()
    walker.statuses.clear()
    goal = walker.send(message(planned, steps))
    walker.wait(lambda: goal.executing == 2, "step 2")
    walker.wait(lambda: not walker.state().contacts[0], "the left foot in the air", period=0.002)
    walker.cancel(goal)
    assert walker.outcome(goal) == (GoalStatus.STATUS_CANCELED, S.PREMATURE_HALT)
    stopped = next(status for status in walker.status() if status.reason)
    assert stopped.executing_step_index == 2, "stopped while the foot swung"
    assert walker.status()[-1].last_performed_step_index == 3  # beside it
    walker.rest()
    assert walker.state().behavior == "stand"
    _, sole = planned[2]
    beside = sole @ level(0.0, -ROBOT.tables.walking.step_width, 0.0, 0.0)
    check(walker.soles(), {0: sole, 1: beside}, record_property, walker.true_soles(), to_world)
