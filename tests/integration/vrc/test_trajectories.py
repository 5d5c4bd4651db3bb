"""Trajectories of a simulated robot's arms, hands, neck and pelvis: reached, refused, canceled, asked for."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from control_msgs.msg import JointTrajectoryControllerState

import bifrost
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import (
    FORWARD,
    HOME,
    INVALID_GOAL,
    INVALID_JOINTS,
    PATIENCE,
    ROBOT,
    STATUS_ABORTED,
    STATUS_CANCELED,
    STATUS_SUCCEEDED,
    SUCCESSFUL,
    Topic,
    errors,
    go,
    pass_robot_time,
    resting,
    send,
)
from valor.common.topics import JOINT_SETPOINTS, MOTION_STATE
from valor.robot.commanded_limits import CommandedLimits

PELVIS_NAMES = tuple(f"pelvis_{axis}" for axis in ("x", "y", "z", "roll", "pitch", "yaw"))


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
    limit = CommandedLimits.of_joints(ROBOT).select(np.array([ROBOT.index[name] for name in names])).fastest
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


def test_a_hand_closes_and_opens(manipulating: RosClient) -> None:
    other = ROBOT.tables.hand_presets["open"]["left"]
    before = resting(manipulating)
    for preset in ("close", "open"):
        target = ROBOT.tables.hand_presets[preset]["right"]
        answer = manipulating.follow("right_hand", [(1.0, target)])
        assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
        wait_until(
            lambda t=target: max(errors(manipulating, t).values()) < 0.05,  # type: ignore[misc]
            PATIENCE,
            f"the hand to {preset}",
        )
        after = manipulating.joint_positions()
        assert max(abs(after[joint] - before[joint]) for joint in other) < 0.05, "the other hand moved"


def test_legs_take_no_goals_and_say_so_but_report_their_state(manipulating: RosClient) -> None:
    answer = manipulating.follow("left_leg", [(1.0, {"l_knee_pitch": 0.5})])
    assert answer.status == STATUS_ABORTED and answer.result.error_code == INVALID_GOAL
    assert "left_leg_traj_controller accepts no goals: the legs carry the robot" in answer.result.error_string
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
