"""The VRC between a real Motion System, a simulated robot and an ordinary ROS 2 client."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys
from typing import Any, Literal

import numpy as np
import pytest

import bifrost
from harness.instance import RunningInstance
from harness.places import ROBOTS
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import PATIENCE, VRC, Topic, ask, go, pass_robot_time, resting, stamp
from valor.common.messages import (
    ControlModeReport,
    Proprioceptor,
)
from valor.common.processes import BY_NAME, EXIT_CONFIGURATION
from valor.common.topics import (
    CONTROL_MODE,
    JOINT_SETPOINTS,
    MOTION_STATE,
    PROPRIOCEPTOR,
    REJECTION,
    STATISTICS,
)
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription

PELVIS_NAMES = tuple(f"pelvis_{axis}" for axis in ("x", "y", "z", "roll", "pitch", "yaw"))
ROBOT = RobotDescription.load(ROBOTS / "escher")
HOME = ROBOT.tables.arm_presets["home"]["right"]
FORWARD = ROBOT.tables.arm_presets["forward"]["right"]
SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS, PATH_TOLERANCE_VIOLATED = 0, -1, -2, -4
ACCEPTED, REJECTED, DUPLICATE, EXTERNAL_CHANGE = 1, 2, 16, 32
NOT_READY, INVALID_MODE, INVALID_TRANSITION = 512, 1024, 2048
STATUS_SUCCEEDED, STATUS_CANCELED, STATUS_ABORTED = 4, 5, 6


@pytest.fixture
def manipulating(ros: RosClient) -> RosClient:
    go(ros, "stand")
    go(ros, "stand_manipulate")
    return ros


def errors(ros: RosClient, target: dict[str, float]) -> dict[str, float]:
    positions = ros.joint_positions()
    return {name: abs(positions[name] - value) for name, value in target.items()}


def test_joint_states_and_imu_are_what_the_proprioceptor_says(ros: RosClient, node: bifrost.Node) -> None:
    from sensor_msgs.msg import Imu, JointState

    senses = PROPRIOCEPTOR.subscriber(node, queue=10_000)
    states, imu = Topic(ros, JointState, "/joint_states"), Topic(ros, Imu, "/imu/data")
    measured: dict[int, Proprioceptor] = {}

    def gathered() -> bool:
        measured.update((received.message.time, received.message) for received in senses.drain())
        return len(states.messages) > 250 and len(imu.messages) > 250

    wait_until(gathered, PATIENCE, "a second of joint states")
    states.close()
    imu.close()
    senses.close()
    matched = [(state, measured[stamp(state)]) for state in states.messages if stamp(state) in measured]
    assert len(matched) > 0.8 * len(states.messages), "stamps are not those of Proprioceptor"
    for state, sense in matched:
        assert list(state.name) == list(ROBOT.joints)
        assert np.array_equal(state.position, sense.joint_position)
        assert np.array_equal(state.velocity, sense.joint_velocity)
        assert np.array_equal(state.effort, sense.joint_effort)
    steps = np.diff(sorted(stamp(state) for state in states.messages)) * 1e-9 * ROBOT.tables.control_rate
    # A busy computer leaves some out.
    assert np.quantile(steps, 0.25) == pytest.approx(2.0), "every second Proprioceptor"
    for message in imu.messages:
        if (sense := measured.get(stamp(message))) is not None:
            q = message.orientation
            assert [q.w, q.x, q.y, q.z] == sense.imu_orientation.tolist()
    assert imu.messages[0].header.frame_id == "imu_link"


def test_cmd_vel_walks_in_mode_walk_and_nowhere_else(ros: RosClient, node: bifrost.Node) -> None:
    from geometry_msgs.msg import Twist

    publisher = ros.node.create_publisher(Twist, "/cmd_vel", 1)
    motion = MOTION_STATE.subscriber(node)
    twist = Twist()
    twist.linear.x = 0.3
    places: list[float] = []
    times: list[int] = []

    def walked(distance: float) -> bool:
        publisher.publish(twist)
        state = motion.latest()
        if state is not None:
            assert state.message.behavior in ("stand", "walk"), state.message.reason
            places.append(float(state.message.pelvis_position_in_odom[0]))
            times.append(state.message.time)
        return bool(places) and places[-1] - places[0] > distance

    def stood() -> bool:
        assert not walked(0.1)
        return bool(times) and times[-1] - times[0] > 400_000_000

    go(ros, "stand")
    wait_until(stood, PATIENCE, "0.4 s of robot time", period=0.02)
    go(ros, "walk")
    wait_until(lambda: walked(0.4), PATIENCE, "walking 0.4 m", period=0.02)
    go(ros, "stand")
    ros.destroy(ros.node.destroy_publisher, publisher)
    motion.close()


def test_tf_odometry_and_clock(ros: RosClient) -> None:
    from nav_msgs.msg import Odometry
    from rosgraph_msgs.msg import Clock
    from tf2_msgs.msg import TFMessage

    fixed, moving = Topic(ros, TFMessage, "/tf_static", latched=True), Topic(ros, TFMessage, "/tf")
    odom, clock = Topic(ros, Odometry, "/odom"), Topic(ros, Clock, "/clock")
    topics = (fixed, moving, odom, clock)
    wait_until(lambda: all(topic.messages for topic in topics), PATIENCE, "tf, odometry and clock")
    parents = {
        transform.child_frame_id: transform.header.frame_id
        for message in (fixed.messages[0], moving.messages[0])
        for transform in message.transforms
    }
    for frame in ("l_sole", "r_gripper", "gaze", "torso", "imu_link", "pelvis", "base_footprint"):
        chain = [frame]
        while chain[-1] in parents:
            chain.append(parents[chain[-1]])
            assert len(chain) < 30, f"a loop above {frame}"
        assert chain[-1] == "odom", f"{frame} hangs from {chain[-1]}"
    height = odom.messages[-1].pose.pose.position.z
    assert 0.5 < height < 1.2
    footprint = next(t for t in moving.messages[-1].transforms if t.child_frame_id == "base_footprint")
    assert abs(footprint.transform.translation.z) < 0.1
    assert clock.messages[-1].clock.sec * 10**9 + clock.messages[-1].clock.nanosec > 0
    for topic in topics:
        topic.close()


def test_modes(ros: RosClient, node: bifrost.Node) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    go(ros, "stand")
    reports = CONTROL_MODE.subscriber(node, queue=1000)
    repeat = ros.change_mode("STAND")
    assert repeat.status == ACCEPTED | DUPLICATE and repeat.current_control_mode == "stand"
    for name, status in (("dance", REJECTED | INVALID_MODE), ("none", REJECTED | INVALID_TRANSITION)):
        result = ros.change_mode(name)
        assert (result.status, result.current_control_mode) == (status, "stand")
    diagnostics = Topic(ros, DiagnosticArray, "/diagnostics")

    def said() -> dict[str, str]:
        return {
            pair.key: pair.value
            for message in diagnostics.messages[-1:]
            for status in message.status
            for pair in status.values
        }

    wait_until(lambda: "none: not allowed from stand" in said().get("last control mode refused", ""), PATIENCE, "why")
    assert said()["behavior"] == "stand"
    diagnostics.close()
    result = ros.change_mode("Stand_Manipulate")
    assert (result.status, result.current_control_mode) == (ACCEPTED, "stand_manipulate")
    wait_until(
        lambda: [r for r in ros.reports if r.current_control_mode == "stand_manipulate" and r.status == ACCEPTED],
        PATIENCE,
        "the report of stand_manipulate on ROS",
    )
    assert any(report.status & 8 for report in ros.reports), "no report said that the change is processed"
    seen: list[ControlModeReport] = []

    def twin() -> bool:
        seen.extend(received.message for received in reports.drain())
        return bool(seen) and seen[-1].current_control_mode == "stand_manipulate"

    wait_until(twin, PATIENCE, "the report on Bifrost")
    assert seen[-1].behavior == "stand_manipulate"
    reports.close()


def test_the_topic_changes_modes_and_an_emergency_stop_keeps_the_balance(ros: RosClient, node: bifrost.Node) -> None:
    from vigir_humanoid_control_msgs.msg import VigirControlModeCommand

    go(ros, "stand")
    publisher = ros.node.create_publisher(VigirControlModeCommand, "/flor/controller/mode_command", 1)
    wait_until(lambda: publisher.get_subscription_count() > 0, PATIENCE, "the VRC to listen to mode_command")
    publisher.publish(VigirControlModeCommand(requested_control_mode=VigirControlModeCommand.EMERGENCY_STOP))
    wait_until(lambda: ros.reports and ros.reports[-1].current_control_mode == "soft_stop", PATIENCE, "soft_stop")
    state = MOTION_STATE.subscriber(node)
    received = state.receive(PATIENCE)
    assert received is not None and received.message.behavior == "soft_stop"
    state.close()
    publisher.publish(VigirControlModeCommand(requested_control_mode="stand"))
    wait_until(lambda: ros.reports[-1].current_control_mode == "stand", PATIENCE, "stand")
    # What is no message at all leaves the VRC unmoved.
    publisher.publish(b"\x00\x01\x00\x00" + b"\xff" * 40)
    assert ros.change_mode("stand").status == ACCEPTED | DUPLICATE
    ros.destroy(ros.node.destroy_publisher, publisher)


def test_goals_are_refused_in_stand(ros: RosClient) -> None:
    go(ros, "stand")
    before = resting(ros)
    answer = ros.follow("right_arm", [(2.0, FORWARD)])
    assert answer.status == STATUS_ABORTED and answer.result.error_code == INVALID_GOAL
    assert "right_arm_traj_controller" in answer.result.error_string and "stand" in answer.result.error_string
    assert max(errors(ros, {name: before[name] for name in FORWARD}).values()) < 0.02


def test_arm_and_neck_reach_their_goals_without_a_jump(manipulating: RosClient, node: bifrost.Node) -> None:
    setpoints = JOINT_SETPOINTS.subscriber(node, queue=10_000)
    wait_until(setpoints.ready, PATIENCE, "set-points")
    answer = manipulating.follow("right_arm", [(0.5, HOME), (2.5, FORWARD)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
    assert answer.status == STATUS_SUCCEEDED
    neck = {"neck_yaw": 0.4, "neck_pitch": 0.2}
    answer = manipulating.follow("neck", [(1.0, neck)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
    target = FORWARD | neck
    wait_until(lambda: max(errors(manipulating, target).values()) < 0.02, PATIENCE, "the arm within 0.02 rad")
    messages = [received.message for received in setpoints.drain()]
    assert setpoints.drops == 0 and len(messages) > 100
    setpoints.close()
    names = messages[0].names
    limit = CommandedLimits.of_joints(ROBOT).select([ROBOT.index[name] for name in names]).fastest
    for before, after in itertools.pairwise(messages):
        seconds = max((after.time - before.time) * 1e-9, 0.004)
        assert (np.abs(after.position - before.position) <= 1.06 * limit * seconds + 1e-6).all(), "a jump"
    manipulating.follow("right_arm", [(2.0, HOME)])


def test_broken_goals_are_refused_and_nothing_moves(manipulating: RosClient) -> None:
    before = resting(manipulating)
    broken = [
        ([(3.0, FORWARD | {"r_tail_wag": 0.1})], INVALID_JOINTS, "r_tail_wag"),
        ([(3.0, {"r_elbow_pitch": 0.1})], INVALID_JOINTS, "missing"),
        ([(3.0, FORWARD | {"r_elbow_pitch": math.nan})], INVALID_GOAL, "r_elbow_pitch"),
        ([(3.0, FORWARD | {"r_wrist_yaw": math.inf})], INVALID_GOAL, "r_wrist_yaw"),
        ([(3.0, FORWARD | {"r_elbow_pitch": 9.0})], INVALID_GOAL, "3.665"),
        ([(0.2, FORWARD)], INVALID_GOAL, "its limit is 1.6752 rad/s"),
        ([(3.0, FORWARD), (2.0, HOME)], INVALID_GOAL, "not after"),
        ([(3.0, HOME), (3.1, FORWARD)], INVALID_GOAL, "between points 0 and 1"),
    ]
    for points, code, word in broken:
        answer = manipulating.follow("right_arm", points)
        assert answer.status == STATUS_ABORTED, word
        assert answer.result.error_code == code and word in answer.result.error_string, answer.result
    assert max(errors(manipulating, {name: before[name] for name in FORWARD}).values()) < 0.02


def send(ros: RosClient, target: dict[str, float], seconds: float) -> Any:
    """A goal under way."""
    from builtin_interfaces.msg import Duration
    from control_msgs.action import FollowJointTrajectory
    from trajectory_msgs.msg import JointTrajectoryPoint

    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = list(target)
    point = JointTrajectoryPoint(positions=list(target.values()), time_from_start=Duration(sec=int(seconds)))
    goal.trajectory.points = [point]
    client = ros._trajectory["right_arm"]
    assert client.wait_for_server(PATIENCE)
    handle = ros._wait(ros._call(client.send_goal_async, goal), PATIENCE, "an answer to the goal")
    assert handle.accepted
    return handle


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_hand_closes_and_opens(manipulating: RosClient, side: Literal["left", "right"]) -> None:
    other = ROBOT.tables.hand_presets["open"]["right" if side == "left" else "left"]
    before = resting(manipulating)
    for preset in ("close", "open"):
        target = ROBOT.tables.hand_presets[preset][side]
        answer = manipulating.follow(f"{side}_hand", [(1.0, target)])
        assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
        wait_until(lambda t=target: max(errors(manipulating, t).values()) < 0.05, PATIENCE, f"the hand to {preset}")
        after = manipulating.joint_positions()
        assert max(abs(after[joint] - before[joint]) for joint in other) < 0.05, "the other hand moved"


def test_legs_take_no_goals_and_say_so_but_report_their_state(manipulating: RosClient) -> None:
    from control_msgs.msg import JointTrajectoryControllerState

    answer = manipulating.follow("left_leg", [(1.0, {"l_knee_pitch": 0.5})])
    assert answer.status == STATUS_ABORTED and answer.result.error_code == INVALID_GOAL
    assert "left_leg_traj_controller takes no goals: the legs carry the robot" in answer.result.error_string
    states = Topic(
        manipulating,
        JointTrajectoryControllerState,
        "/trajectory_controllers/left_leg_traj_controller/controller_state",
    )
    wait_until(lambda: len(states.messages) > 3, PATIENCE, "the legs' state")
    state = states.messages[-1]
    states.close()
    assert list(state.joint_names) == list(ROBOT.tables.groups["left_leg"])
    measured = manipulating.joint_positions()
    assert list(state.feedback.positions) == pytest.approx([measured[name] for name in state.joint_names], abs=0.05)
    assert np.asarray(state.error.positions) == pytest.approx(
        np.asarray(state.reference.positions) - np.asarray(state.feedback.positions)
    )


def test_the_pelvis_is_led_in_manipulate_and_nowhere_else(manipulating: RosClient, node: bifrost.Node) -> None:
    height = ROBOT.tables.nominal_base_height
    home = dict(zip(PELVIS_NAMES, (0.0, 0.0, height, 0.0, 0.0, 0.0), strict=True))
    low = home | {"pelvis_z": height - 0.05, "pelvis_yaw": 0.1}
    answer = manipulating.follow("pelvis", [(3.0, low)])
    assert answer.result.error_code == INVALID_GOAL and "manipulate" in answer.result.error_string
    go(manipulating, "manipulate")
    answer = manipulating.follow("pelvis", [(3.0, low | {"pelvis_z": 2.0})])
    assert answer.result.error_code == INVALID_GOAL and "pelvis_z at 2 m" in answer.result.error_string
    answer = manipulating.follow("pelvis", [(3.0, low)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
    motion = MOTION_STATE.subscriber(node)
    received = motion.receive(PATIENCE)
    motion.close()
    assert received is not None
    assert received.message.pelvis_in_support[2] == pytest.approx(height - 0.05, abs=0.03)
    assert received.message.pelvis_in_support[5] == pytest.approx(0.1, abs=0.05)
    answer = manipulating.follow("pelvis", [(3.0, home)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string


def test_the_controller_manager_lists_and_switches_within_the_control_mode(manipulating: RosClient) -> None:
    from controller_manager_msgs.srv import (
        ListControllers,
        ListHardwareComponents,
        LoadController,
        SwitchController,
    )

    def listed() -> dict[str, Any]:
        answer = ask(manipulating, ListControllers, "/controller_manager/list_controllers")
        return {controller.name: controller for controller in answer.controller}

    def switch(strictness: int, **names: list[str]) -> Any:
        return ask(
            manipulating, SwitchController, "/controller_manager/switch_controller", strictness=strictness, **names
        )

    strict, best_effort = SwitchController.Request.STRICT, SwitchController.Request.BEST_EFFORT
    arm = "right_arm_traj_controller"
    before = listed()
    assert before[arm].state == "active"
    assert before[arm].type == "joint_trajectory_controller/JointTrajectoryController"
    assert "r_elbow_pitch/position" in before[arm].claimed_interfaces
    assert before["pelvis_traj_controller"].state == "inactive"
    assert before["control_mode_controller"].state == before["left_leg_traj_controller"].state == "active"
    (component,) = ask(manipulating, ListHardwareComponents, "/controller_manager/list_hardware_components").component
    assert component.state.label == "active"
    claimed = {i.name for i in component.command_interfaces if i.is_claimed}
    assert "r_elbow_pitch/position" in claimed and "l_knee_pitch/position" not in claimed

    refused = switch(strict, activate_controllers=["pelvis_traj_controller"], deactivate_controllers=[arm])
    assert not refused.ok and "pelvis_traj_controller" in refused.message, refused
    assert "stand_manipulate" in refused.message and listed()[arm].state == "active", "strict: all or nothing"
    assert not switch(strict, deactivate_controllers=["no_controller"]).ok
    partly = switch(best_effort, activate_controllers=["pelvis_traj_controller", arm])
    assert partly.ok and "pelvis_traj_controller" in partly.message

    held = resting(manipulating)
    assert switch(strict, deactivate_controllers=[arm]).ok
    assert listed()[arm].state == "inactive" and not listed()[arm].claimed_interfaces
    answer = manipulating.follow("right_arm", [(2.0, HOME)])
    assert answer.result.error_code == INVALID_GOAL and "not active" in answer.result.error_string
    assert switch(strict, activate_controllers=[arm]).ok
    assert listed()[arm].state == "active"
    assert max(errors(manipulating, {name: held[name] for name in HOME}).values()) < 0.02
    answer = manipulating.follow("right_arm", [(2.0, HOME)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
    assert not ask(manipulating, LoadController, "/controller_manager/load_controller", name=arm).ok


def test_parameters_change_at_run_time_and_bad_values_are_refused(manipulating: RosClient) -> None:
    from rcl_interfaces.srv import DescribeParameters, SetParameters
    from rclpy.parameter import Parameter

    prefix = "right_arm_traj_controller"

    def change(name: str, value: Any) -> Any:
        parameter = Parameter(f"{prefix}.{name}", value=value).to_parameter_msg()
        answer = ask(manipulating, SetParameters, f"/{VRC}/set_parameters", parameters=[parameter])
        return answer.results[0]

    names = [f"{prefix}.constraints.goal_time"]
    (described,) = ask(manipulating, DescribeParameters, f"/{VRC}/describe_parameters", names=names).descriptors
    assert described.description and described.floating_point_range[0].from_value == 0.0
    for name, value in (
        ("constraints.goal_time", -1.0),
        ("constraints.r_elbow_pitch.goal", math.nan),
        ("action_monitor_rate", 0.0),
        ("allow_partial_joints_goal", "yes"),
    ):
        refused = change(name, value)
        assert not refused.successful and ("range" in refused.reason or "BOOL" in refused.reason), refused
    partial = {"r_elbow_pitch": HOME["r_elbow_pitch"] + 0.2}
    assert manipulating.follow("right_arm", [(1.0, partial)]).result.error_code == INVALID_JOINTS
    assert change("allow_partial_joints_goal", True).successful
    try:
        answer = manipulating.follow("right_arm", [(1.0, partial)])
        assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
        # A tolerance that nothing meets.
        assert change("constraints.r_elbow_pitch.trajectory", 1e-9).successful
        answer = manipulating.follow("right_arm", [(1.0, {"r_elbow_pitch": HOME["r_elbow_pitch"]})])
        assert answer.result.error_code == PATH_TOLERANCE_VIOLATED, answer.result
        assert "path tolerance violation: r_elbow_pitch" in answer.result.error_string
    finally:
        assert change("constraints.r_elbow_pitch.trajectory", 0.3).successful
        assert change("allow_partial_joints_goal", False).successful


def test_a_trajectory_under_way_is_asked_where_it_will_be(manipulating: RosClient) -> None:
    from builtin_interfaces.msg import Time
    from control_msgs.srv import QueryTrajectoryState

    base = "/trajectory_controllers/right_arm_traj_controller"
    handle = send(manipulating, FORWARD, 4.0)
    manipulating._wait(
        manipulating._call(handle.cancel_goal_async), PATIENCE, "the cancellation"
    )  # at rest wherever it is
    manipulating.follow("right_arm", [(1.5, HOME)])
    handle = send(manipulating, FORWARD, 3.0)
    state = manipulating.joint_state
    assert state is not None
    soon = stamp(state) + 1_000_000_000
    answer = ask(
        manipulating, QueryTrajectoryState, f"{base}/query_state", time=Time(sec=soon // 10**9, nanosec=soon % 10**9)
    )
    assert answer.success, answer.message
    assert list(answer.name) == list(HOME)
    fraction = [
        (there - HOME[name]) / (FORWARD[name] - HOME[name])
        for name, there in zip(answer.name, answer.position, strict=True)
        if abs(FORWARD[name] - HOME[name]) > 0.1
    ]
    assert max(fraction) - min(fraction) < 0.05 and 0.1 < np.mean(fraction) < 0.6, fraction
    early = ask(manipulating, QueryTrajectoryState, f"{base}/query_state", time=Time(sec=1))
    assert not early.success and "before the trajectory begins" in early.message
    manipulating._wait(manipulating._call(handle.get_result_async), PATIENCE, "the end of the goal")
    manipulating.follow("right_arm", [(2.0, HOME)])


def test_a_canceled_goal_holds(manipulating: RosClient) -> None:
    manipulating.follow("right_arm", [(2.0, HOME)])
    handle = send(manipulating, FORWARD, 6.0)
    elbow = "r_shoulder_pitch"
    wait_until(lambda: abs(manipulating.joint_positions()[elbow] - HOME[elbow]) > 0.15, PATIENCE, "the arm to move")
    manipulating._wait(manipulating._call(handle.cancel_goal_async), PATIENCE, "the cancellation")
    answer = manipulating._wait(manipulating._call(handle.get_result_async), PATIENCE, "the end of the goal")
    assert answer.status == STATUS_CANCELED
    held = resting(manipulating)
    pass_robot_time(manipulating, 1.0)
    assert max(errors(manipulating, {name: held[name] for name in FORWARD}).values()) < 0.02
    assert abs(held[elbow] - FORWARD[elbow]) > 0.2, "the arm went to the goal"


def test_leaving_the_mode_aborts_the_goal(manipulating: RosClient) -> None:
    handle = send(manipulating, FORWARD, 6.0)
    assert manipulating.change_mode("stand").status == ACCEPTED
    answer = manipulating._wait(manipulating._call(handle.get_result_async), PATIENCE, "the end of the goal")
    assert answer.status == STATUS_ABORTED and "control mode stand" in answer.result.error_string


def test_mode_changes_do_not_make_the_motion_system_refuse_set_points_for_long(
    manipulating: RosClient, node: bifrost.Node
) -> None:
    rejections = REJECTION.subscriber(node, queue=1000)
    for mode in ("stand", "stand_manipulate", "manipulate", "stand", "stand_manipulate"):
        assert manipulating.change_mode(mode).status == ACCEPTED
    pass_robot_time(manipulating, 0.5)
    assert manipulating.change_mode("stand_manipulate").status == ACCEPTED | DUPLICATE
    pass_robot_time(manipulating, 0.5)
    late = rejections.latest()
    assert late is None or late.message.count < 200, "set-points go on being sent where they are not accepted"
    rejections.close()


def test_killed_it_comes_back_with_the_true_mode_and_the_arms_hold(
    system: RunningInstance, manipulating: RosClient, node: bifrost.Node
) -> None:
    held = resting(manipulating)
    system.kill(VRC)
    state = MOTION_STATE.subscriber(node)
    manipulating.reports.clear()
    system.start(VRC)
    system.wait_ready(VRC, PATIENCE)
    wait_until(lambda: manipulating.reports, PATIENCE, "a report of the restarted VRC")
    wait_until(lambda: manipulating.reports[-1].current_control_mode == "stand_manipulate", PATIENCE, "the true mode")
    assert manipulating.reports[-1].status == EXTERNAL_CHANGE
    received = state.receive(PATIENCE)
    assert received is not None and received.message.behavior == "stand_manipulate"
    state.close()
    assert max(errors(manipulating, {name: held[name] for name in FORWARD}).values()) < 0.05
    answer = manipulating.follow("right_arm", [(2.0, HOME)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string


def test_a_dead_motion_manager_aborts_goals_by_name_and_its_return_is_followed(
    system: RunningInstance, manipulating: RosClient
) -> None:
    handle = send(manipulating, FORWARD, 6.0)
    system.kill("motion_manager")
    try:
        answer = manipulating._wait(manipulating._call(handle.get_result_async), PATIENCE, "the end of the goal")
        assert answer.status == STATUS_ABORTED and "motion_manager is silent" in answer.result.error_string
        assert manipulating.change_mode("stand").status == REJECTED | NOT_READY
    finally:
        system.start("motion_manager")
    wait_until(
        lambda: manipulating.reports[-1].current_control_mode == "freeze",
        PATIENCE,
        "the mode of the restarted Motion Manager",
    )


def test_a_dead_comms_manager_is_named_and_its_return_is_followed(
    system: RunningInstance, ros: RosClient, node: bifrost.Node
) -> None:
    statistics = STATISTICS["valor_ros_controller"].subscriber(node)

    def detail() -> str:
        received = statistics.receive(1.0)
        return received.message.detail if received else ""

    system.kill("comms_manager")
    wait_until(lambda: "comms_manager" in detail(), PATIENCE, "the VRC to name the silent process")
    system.start("comms_manager")
    system.wait_ready(VRC, PATIENCE)
    statistics.close()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-p", "update_rate:=1000.0"], ("update_rate", "1000", "expected 1 to 500")),
        (["-p", "update_rate:=fast"], ("update_rate", "fast", "expected 1 to 500")),
    ],
)
def test_wrong_parameters_end_it_with_one_line(
    system: RunningInstance, ros_domain: int, arguments: list[str], words: tuple[str]
) -> None:
    command = [sys.executable, "-m", BY_NAME[VRC].module, "--ros-args", *arguments]
    environment = system.environment | {"ROS_DOMAIN_ID": str(ros_domain)}
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert result.returncode == EXIT_CONFIGURATION, result.stderr
    assert "Traceback" not in result.stderr, result.stderr
    lines = [line for line in result.stderr.splitlines() if "ERROR" in line]
    assert len(lines) == 1 and all(word in lines[0] for word in words), result.stderr


def test_sigterm_ends_it_in_order(system: RunningInstance) -> None:
    assert system.stop(VRC) == 0
    log = system.log(VRC)
    assert "Traceback" not in log, log
    assert "RTPS" not in log, log
    assert log.rstrip().endswith("stopped")
