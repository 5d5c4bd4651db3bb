"""A joint trajectory controller over whole goals, with joints that follow, lag or stick."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from control_msgs.msg import JointTolerance

from harness import motion_states
from harness.places import ROBOTS
from valor.common.messages import MotionState
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.controllers.configuration import TrajectoryControllerConfig
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.controllers.table import ControllersTable
from valor.valor_ros_controller.controllers.trajectory_goal import (
    TrajectoryGoal,
    TrajectoryOutcome,
    TrajectoryRequest,
    stated,
)
from valor.valor_ros_controller.trajectory.admission import check_waypoints
from valor.valor_ros_controller.trajectory.waypoints import ErrorCode, InvalidTrajectoryError, Point, Tolerances
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

ROBOT = RobotDescription.load(ROBOTS / "escher")
CONFIG = ControllersTable.load().of_type(TrajectoryControllerConfig)["left_arm_traj_controller"]
NAMES = ROBOT.tables.groups["left_arm"]
HOME = ROBOT.nominal_posture
PERIOD = 4_000_000


def motion_state(behavior: str, setpoint: np.ndarray) -> MotionState:
    manipulation, leader = ("teleop", "setpoints") if behavior.endswith("_manipulate") else ("slave", "nobody")
    arms: dict[str, Any] = {"left_arm": leader, "right_arm": leader}
    return motion_states.motion_state(
        behavior=behavior, manipulation=manipulation, **arms, joint_setpoint=setpoint, pelvis_in_support=np.zeros(6)
    )


@dataclass
class Client:
    """Keeps what it is told."""

    outcome: Any = None  # an TrajectoryOutcome, once it is told
    feedbacks: list[int] = field(default_factory=list)

    def finish(self, outcome: TrajectoryOutcome) -> None:
        assert self.outcome is None, "finished twice"
        self.outcome = outcome

    def feedback(self, hw: ValorEscherHWInterface) -> None:
        self.feedbacks.append(hw.time)


class Arm:
    """The controller on its interface, and joints that follow its set-points as told."""

    def __init__(self, sticky: str | None = None) -> None:
        self.hw = ValorEscherHWInterface(ROBOT)
        self.hw.time = 1_000_000_000
        self.hw.position = HOME.copy()
        self.say("stand_manipulate", HOME)
        self.hw.situation = "control mode stand"
        self.controller = JointTrajectoryController("left_arm_traj_controller", CONFIG, self.hw, ["stand_manipulate"])
        self.sticky = sticky
        self.sent: list[np.ndarray] = []

    def say(self, behavior: str, setpoint: Any) -> None:
        """What the Motion System reports."""
        self.hw.motion = motion_state(behavior, np.array(setpoint))
        self.hw.commanded = self.hw.motion.joint_setpoint

    def start(self) -> Arm:
        self.controller.start(self.hw)
        self.run(0.02)
        return self

    def request(
        self,
        points: Sequence[Point],
        goal: TrajectoryGoal | None = None,
        names: Sequence[str] = NAMES,
        start: int = 0,
        goal_time: float | None = None,
    ) -> None:
        waypoints = check_waypoints(names, points, self.controller.limits, allow_partial=True)
        c = self.controller
        time = CONFIG.constraints.goal_time if goal_time is None else goal_time
        c.submit(TrajectoryRequest(waypoints, start, c.settings.path, c.settings.goal, time, goal))

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        for _ in range(round(seconds * 1e9 / PERIOD)):
            self.hw.time += PERIOD
            self.controller.update(self.hw)
            if self.hw.written.size:
                position, velocity, _ = self.hw.rectify()
                self.sent.append(position)
                before = self.hw.position
                self.hw.position, self.hw.velocity = before.copy(), np.zeros(len(HOME))
                self.hw.position[self.hw.written] = position
                self.hw.velocity[self.hw.written] = velocity
                if self.sticky:
                    stuck = ROBOT.index[self.sticky]
                    self.hw.position[stuck], self.hw.velocity[stuck] = before[stuck], 0.0
            if until():
                return

    @property
    def arm(self) -> np.ndarray:
        return self.hw.position[self.controller.joints]

    def assert_no_jump(self) -> None:
        sent = np.array(self.sent)
        limit = ROBOT.velocity_limit[self.controller.joints] * PERIOD * 1e-9 + 1e-8
        assert (np.abs(np.diff(sent, axis=0)) <= limit).all()


def target(offset: float) -> list[float]:
    return [HOME[ROBOT.index[name]] + offset for name in NAMES]


def point(seconds: float, offset: float) -> Point:
    return Point(target(offset), [], [], [], seconds)


def test_a_goal_is_reached_with_feedback_at_its_rate() -> None:
    arm, client = Arm().start(), Client()
    arm.request([point(1.0, 0.2), point(2.0, 0.1)], client)
    arm.run(3.0, lambda: client.outcome is not None)
    assert client.outcome == TrajectoryOutcome(ErrorCode.SUCCESSFUL, "Goal successfully reached!")
    assert arm.arm == pytest.approx(target(0.1), abs=1e-6)
    assert len(client.feedbacks) == pytest.approx(2.0 * CONFIG.action_monitor_rate, abs=2)
    arm.assert_no_jump()


def test_it_begins_where_the_motion_system_commands_not_where_the_arm_sags() -> None:
    arm = Arm()
    arm.hw.position = HOME - 0.04
    arm.controller.start(arm.hw)
    arm.hw.time += PERIOD
    arm.controller.update(arm.hw)
    assert arm.hw.rectify()[0] == pytest.approx(HOME[np.sort(arm.controller.joints)])


def test_it_keeps_sending_its_set_point_when_idle() -> None:
    arm = Arm().start()
    count = len(arm.sent)
    arm.run(0.1)
    assert len(arm.sent) == count + 25


@pytest.mark.parametrize(
    ("active", "words"), [(False, ("left_arm_traj_controller", "control mode stand")), (True, ("behavior stand",))]
)
def test_inactive_or_not_accepted_it_sends_nothing_and_refuses(active: bool, words: tuple[str, ...]) -> None:
    arm, client = Arm(), Client()
    if active:
        arm.say("stand", HOME)
        arm.start()
    arm.request([point(1.0, 0.1)], client)
    arm.run(0.1)
    assert client.outcome.code is ErrorCode.INVALID_GOAL and all(word in client.outcome.text for word in words)
    assert not arm.sent


def test_a_frozen_limb_loses_its_goal_takes_no_other_and_begins_where_it_is() -> None:
    arm, clients = Arm().start(), (Client(), Client())
    arm.request([point(1.0, 0.4)], clients[0])
    arm.run(0.5)
    held = arm.arm.copy()
    arm.hw.frozen, arm.hw.commanded = ("left_arm",), arm.hw.position.copy()
    arm.run(0.1)
    arm.request([point(1.0, 0.0)], clients[1])
    arm.run(0.1)
    assert all(client.outcome.code is ErrorCode.INVALID_GOAL for client in clients)
    assert [client.outcome.text for client in clients] == ["aborted: left_arm is frozen", "left_arm is frozen"]
    arm.hw.frozen = ()
    arm.run(0.1)
    assert arm.arm == pytest.approx(held)
    arm.assert_no_jump()


def test_a_flood_of_refusals_is_counted_and_told_once(caplog: pytest.LogCaptureFixture) -> None:
    controller = Arm().start().controller
    for _ in range(1000):
        controller.reject(None, InvalidTrajectoryError("unknown joint 'nobody'", ErrorCode.INVALID_JOINTS))
    controller.reject(None, InvalidTrajectoryError("no joints", ErrorCode.INVALID_JOINTS))
    assert controller.rejections.count == 1001
    assert [record.getMessage().partition("rejected: ")[2] for record in caplog.records] == [
        "unknown joint 'nobody'",
        "no joints (999 more omitted)",
    ]


def test_a_new_goal_replaces_the_old_one_without_a_jump() -> None:
    arm, first, second = Arm().start(), Client(), Client()
    arm.request([point(2.0, 0.5)], first)
    arm.run(1.0)
    arm.request([point(1.0, -0.1)], second)
    arm.run(2.0, lambda: second.outcome is not None)
    assert first.outcome.code is ErrorCode.INVALID_GOAL and "preempted" in first.outcome.text
    assert second.outcome.code is ErrorCode.SUCCESSFUL
    assert arm.arm == pytest.approx(target(-0.1), abs=1e-6)
    arm.assert_no_jump()


def test_a_goal_that_cannot_begin_leaves_the_running_one_alone() -> None:
    arm, first, second = Arm().start(), Client(), Client()
    arm.request([point(1.0, 0.3)], first)
    arm.run(0.5)
    arm.request([point(0.01, -0.3)], second)
    arm.run(1.0, lambda: first.outcome is not None)
    assert second.outcome.code is ErrorCode.INVALID_GOAL and "rad/s" in second.outcome.text
    assert first.outcome.code is ErrorCode.SUCCESSFUL


def test_cancel_comes_to_rest_and_holds() -> None:
    arm, client = Arm().start(), Client()
    arm.request([point(2.0, 0.5)], client)
    arm.run(1.0)
    arm.controller.cancel(client)
    arm.run(0.2)
    assert client.outcome.canceled and client.outcome.code is ErrorCode.SUCCESSFUL
    held = arm.arm
    assert held == pytest.approx(target(0.25), abs=0.02)
    arm.run(1.0)
    assert (arm.arm == held).all()
    arm.assert_no_jump()
    arm.controller.cancel(client)  # too late: nothing happens
    arm.run(0.1)
    assert (arm.arm == held).all()


def test_a_joint_that_sticks_violates_the_path_and_everything_stops() -> None:
    arm, client = Arm(sticky="l_elbow_pitch").start(), Client()
    arm.request([point(2.0, 0.5)], client)
    arm.run(3.0, lambda: client.outcome is not None)
    assert client.outcome.code is ErrorCode.PATH_TOLERANCE_VIOLATED
    assert "l_elbow_pitch" in client.outcome.text and f"{CONFIG.each_joint.trajectory:g}" in client.outcome.text
    arm.run(0.5)
    held = arm.arm
    arm.run(0.5)
    assert (arm.arm == held).all()


def test_a_joint_short_of_the_goal_violates_it_after_the_time_allowed() -> None:
    arm, client = Arm(sticky="l_wrist_yaw").start(), Client()
    arm.request([point(2.0, 0.2)], client, goal_time=0.5)
    arm.run(2.4, lambda: client.outcome is not None)
    assert client.outcome is None, "the goal's time has not passed"
    arm.run(0.3, lambda: client.outcome is not None)
    assert client.outcome.code is ErrorCode.GOAL_TOLERANCE_VIOLATED  # type: ignore[attr-defined]  # set by a callback
    for word in ("l_wrist_yaw", "+0.200", "0.05 rad", "goal_time_tolerance"):
        assert word in client.outcome.text  # type: ignore[attr-defined]  # set by a callback


def test_deactivation_aborts_with_the_reason() -> None:
    arm, client = Arm().start(), Client()
    arm.request([point(2.0, 0.2)], client)
    arm.run(0.5)
    arm.controller.stop(arm.hw, "motion_manager is silent")
    assert client.outcome.code is ErrorCode.INVALID_GOAL and "motion_manager is silent" in client.outcome.text
    assert arm.hw.written.size == 0


def test_while_not_accepted_the_trajectory_waits_and_then_goes_on() -> None:
    arm, client = Arm().start(), Client()
    arm.request([point(1.0, 0.4)], client)
    arm.run(0.5)
    here = arm.arm
    arm.say("stand", arm.hw.position)
    count = len(arm.sent)
    arm.run(0.5)
    assert len(arm.sent) == count and client.outcome is None
    arm.say("stand_manipulate", arm.hw.position)
    arm.run(0.004)
    assert arm.arm == pytest.approx(here, abs=0.005)
    arm.run(1.0, lambda: client.outcome is not None)
    assert client.outcome.code is ErrorCode.SUCCESSFUL  # type: ignore[attr-defined]  # set by a callback
    arm.assert_no_jump()


def test_if_the_motion_system_moved_the_arm_meanwhile_the_goal_is_aborted_and_the_arm_stays() -> None:
    arm, client = Arm().start(), Client()
    arm.request([point(1.0, 0.4)], client)
    arm.run(0.5)
    arm.say("stand", HOME)
    arm.run(0.1)
    arm.say("stand_manipulate", HOME)
    arm.hw.position = HOME.copy()
    arm.run(0.1)
    assert client.outcome.code is ErrorCode.INVALID_GOAL and "moved l_" in client.outcome.text
    assert arm.arm == pytest.approx(target(0.0))


def test_goal_tolerances_override_the_defaults() -> None:
    c = Arm().controller

    def over_with(*entries: tuple[str, float, float]) -> Tolerances:
        messages = [JointTolerance(name=name, position=p, velocity=v) for name, p, v in entries]
        return stated(c.settings.goal, messages, NAMES, "goal_tolerance")

    over = over_with(("l_elbow_pitch", 0.5, 0.0), ("l_wrist_yaw", -1.0, -1.0))
    elbow, wrist = NAMES.index("l_elbow_pitch"), NAMES.index("l_wrist_yaw")
    assert over.position[elbow] == 0.5 and over.velocity[elbow] == c.settings.goal.velocity[elbow]
    assert np.isinf(over.position[wrist]) and np.isinf(over.velocity[wrist])
    for entry, words in (
        (("l_tail", 0.1, 0.0), ("l_tail", "goal_tolerance")),
        (("l_wrist_yaw", float("nan"), 0.0), ("l_wrist_yaw", "nan")),
        (("l_wrist_yaw", -0.5, 0.0), ("-0.5",)),
    ):
        with pytest.raises(InvalidTrajectoryError) as error:
            over_with(entry)
        assert all(word in str(error.value) for word in words)
