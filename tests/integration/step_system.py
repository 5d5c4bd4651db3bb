"""A robot that takes footstep plans, a planner's client and an observer: ordinary ROS 2 and real processes throughout.

Nothing here is timed by the wall but what the robot has no part in: a slow machine slows the robot's clock, and how
long it may take for something is counted in robot time.
"""

import math
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage
from vigir_footstep_planning_msgs.msg import Step, StepPlan
from vigir_humanoid_control_msgs.msg import ControlModeStatus

from harness.instance import RunningInstance, fresh_instance
from harness.places import ROBOTS
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.plan_client import Goal, PlanClient
from tests.integration.vrc.vrc_system import Topic
from valor.common.messages import MotionState, PushRequest, StepStatus
from valor.common.poses import Pose, middle
from valor.common.topics import GROUND_TRUTH, MOTION_STATE, PUSH, STEP_STATUS
from valor.common.transforms import TransformBuffer
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot.step_plan import FEET, PlanStep

ROBOT = RobotDescription.load(ROBOTS / "escher")
SOLES = tuple(ROBOT.frame_of(foot.sole) for foot in (ROBOT.tables.feet.left, ROBOT.tables.feet.right))  # in tf
PROCESSES = ("comms_manager", "motion_manager", "valor_ros_controller", "footstep_converter")
LIMIT = 120.0  # for anything to happen on a loaded machine that the robot has no part in [s]
PATIENCE = 60.0  # for what the robot does [robot time, s]
STILL = 0.01  # a pelvis as slow as that is at rest [m/s]

Soles = tuple[Pose, Pose]  # left, right
Planned = list[tuple[int, Pose]]  # foot and sole of each step, in odom


@dataclass(frozen=True)
class Stance:
    """Where the feet stand before a plan."""

    middle: Pose  # midway between the soles, in odom
    to_world: Pose  # odom in the world


class Walker:
    def __init__(self, instance: RunningInstance, ros: RosClient) -> None:
        self.instance = instance
        self.ros = ros
        self.plans = PlanClient(ros)
        self._tf = TransformBuffer()
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        ros.node.create_subscription(TFMessage, "/tf_static", lambda m: self._hear(m, static=True), latched)
        node = instance.node("observer")
        self._truth = GROUND_TRUTH.subscriber(node)
        self._states = MOTION_STATE.subscriber(node)
        self._statuses = STEP_STATUS.subscriber(node, queue=1000)
        self._push = PUSH.client(node)
        self.statuses: list[StepStatus] = []
        self._model = full_model(ROBOT)

    def _hear(self, message: Any, *, static: bool) -> None:
        for each in message.transforms:
            t, r, stamp = each.transform.translation, each.transform.rotation, each.header.stamp
            pose, at = Pose((t.x, t.y, t.z), (r.w, r.x, r.y, r.z)), stamp.sec * 10**9 + stamp.nanosec
            self._tf.add(each.header.frame_id, each.child_frame_id, at, pose, static=static)

    # --- the robot ------------------------------------------------------------------------------------------------

    def state(self) -> MotionState:
        return wait_until(self._states.latest, LIMIT, MOTION_STATE.name, 0.001).message

    def wait(self, condition: Callable[[], object], what: str, period: float = 0.02) -> None:
        """Wait as long as the robot needs, however slowly its time goes by."""
        until = self.state().time + round(PATIENCE * 1e9)

        def over() -> bool:
            assert self.state().time < until, f"not within {PATIENCE:g} s of robot time: {what}"
            return bool(condition())

        wait_until(over, 10.0 * LIMIT, what, period)

    def rest(self) -> None:

        def still() -> bool:
            state = self.state()
            return bool(state.contacts.all() and np.abs(state.pelvis_linear_velocity_in_odom).max() < STILL)

        self.wait(still, "the robot at rest")

    def soles(self) -> Soles:
        """Poses of the soles in odom, by a tf published from now on."""
        moving = Topic(self.ros, TFMessage, "/tf")
        wait_until(lambda: len(moving.messages) > 5, LIMIT, "tf")
        moving.close()
        for message in moving.messages[-5:]:
            self._hear(message, static=False)
        left, right = (self._tf.lookup("odom", sole) for sole in SOLES)
        return left, right

    def true_soles(self) -> Soles:
        """Where they are in the world, by the simulator."""
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

    def stance(self) -> Stance:
        here = middle(*self.soles())
        return Stance(here, middle(*self.true_soles()) @ here.inverse())

    def push(self, impulse: tuple[float, float, float]) -> None:
        """Push the chest by an impulse in the world [N·s]."""
        assert self._push.call(PushRequest(impulse_in_world=np.array(impulse), duration=0.1), timeout=LIMIT).accepted

    def status(self) -> list[StepStatus]:
        self.statuses += [received.message for received in self._statuses.drain()]
        return self.statuses

    # --- the client -----------------------------------------------------------------------------------------------

    def mode(self, name: str) -> None:
        wait_until(lambda: self.ros.change_mode(name, LIMIT).current_control_mode == name, LIMIT, f"mode {name}", 0.2)

    @property
    def report(self) -> ControlModeStatus:
        return self.ros.reports[-1]

    def send(self, plan: StepPlan) -> Goal:
        """Send a plan; statuses of earlier plans are discarded."""
        self.status()
        self.statuses.clear()
        return self.plans.send(plan)

    def outcome(self, goal: Goal) -> tuple[int, int]:
        self.wait(lambda: goal.result, "the goal's result")
        return self.plans.outcome(goal)[:2]


def put(steps: Sequence[PlanStep], frame: Pose) -> Planned:
    """Foot and sole of each step, in the frame that ``frame`` is in."""
    return [(FEET.index(step.foot), frame @ step.sole) for step in steps]


def message(planned: Planned, like: PlanStep | Sequence[PlanStep]) -> StepPlan:
    """A plan in odom; durations and heights are those of ``like``, of one step for all or of each."""
    plan = StepPlan()
    plan.header.frame_id = "odom"
    likes = [like] * len(planned) if isinstance(like, PlanStep) else like
    for index, (step, (foot, sole)) in enumerate(zip(likes, planned, strict=True)):
        made = Step(step_index=index, valid=True, swing_height=step.swing_height)
        made.step_duration, made.sway_duration = step.step_duration, step.sway_duration
        made.foot.foot_index = foot
        p, q = made.foot.pose.position, made.foot.pose.orientation
        p.x, p.y, p.z = sole.position
        q.w, q.x, q.y, q.z = sole.orientation
        plan.steps.append(made)
    return plan


def error(sole: Pose, place: Pose) -> tuple[float, float]:
    """Distance [m] and turn [rad] of a sole from its place."""
    return math.dist(sole.position, place.position), abs(math.remainder(sole.yaw - place.yaw, math.tau))


@contextmanager
def system(name: str, **settings: object) -> Iterator[Walker]:
    """All processes but the recorder, free-running, the robot standing; an instance of that name and settings."""
    home = Path(tempfile.mkdtemp(prefix="valor-"))
    ros = None
    try:
        with fresh_instance(home, name, **settings) as instance:
            try:
                for process in PROCESSES:
                    instance.start(process)
                for process in PROCESSES:
                    instance.wait_ready(process, LIMIT)
                ros = RosClient(instance.environment, joint_states=False)
                walker = Walker(instance, ros)
                walker.mode("stand")
                walker.rest()
                yield walker
            finally:
                if ros is not None:
                    ros.close()
                for process in PROCESSES:  # shown with a case that fails
                    print(f"--- {process}\n{instance.log(process)}")
    finally:
        shutil.rmtree(home, ignore_errors=True)
