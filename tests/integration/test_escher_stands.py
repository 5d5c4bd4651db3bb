"""ESCHER under `valorctl up` on the wall clock: it stands, reaches and is pushed.

The plant's masses are 5 % off the controller's model, sensors are noisy, torques late (actuators ``hardware``).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest

import bifrost
from harness.system import RosClient, System, leftovers, running, shared_memory
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import stamp
from valor.common.instance import Instance
from valor.common.messages import GroundTruth, MotionState, Proprioceptor
from valor.common.topics import GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR, Topic
from valor.robot.description import RobotDescription

SERVICES = {
    "bifrostd", "motion_manager", "comms_manager", "valor_ros_controller", "footstep_converter", "bag_recorder",
}  # fmt: skip
SUCCESSFUL = 0  # FollowJointTrajectory
MODE_ACCEPTED, EXTERNAL_CHANGE = 1, 32  # ControlModeStatus
STAND = 10.0  # [s]
SETTLED = 300  # samples of the truth, at 100 Hz, until the robot has settled
PUSHES = (("-15", "0", "0"), ("0", "15", "0"))  # [N·s]


@dataclass
class Case:
    """A running system, a ROS client of it and a Bifrost node that watches it."""

    system: System
    ros: RosClient
    node: bifrost.Node
    robot: RobotDescription

    def watch(self, seconds: float) -> tuple[list[MotionState], list[Proprioceptor], list[GroundTruth]]:
        """All that is published in a stretch of robot time [s]."""
        topics: tuple[Topic[Any], ...] = (MOTION_STATE, PROPRIOCEPTOR, GROUND_TRUTH)
        subscribers = [topic.subscriber(self.node, queue=5000) for topic in topics]
        kept: tuple[list[MotionState], list[Proprioceptor], list[GroundTruth]] = ([], [], [])

        def passed() -> bool:
            for subscriber, messages in zip(subscribers, cast("tuple[list[Any], ...]", kept), strict=True):
                messages.extend(received.message for received in subscriber.drain())
            return bool(kept[0]) and kept[0][-1].time - kept[0][0].time >= seconds * 1e9

        wait_until(passed, 60.0 + 20.0 * seconds, f"{seconds:g} s of robot time", 0.05)
        for subscriber in subscribers:
            subscriber.close()
        return kept


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Case]:
    home = tmp_path_factory.mktemp("v")
    before = shared_memory()
    options = ("--clock", "realtime", "--seed", "1", "--actuators", "hardware")
    with running("stands", home, *options) as system:
        ros = RosClient(system.join(), joint_states=False)
        instance = Instance(system.name, home)
        network = bifrost.Network.load(instance.network_file, instance.keys)
        with bifrost.Node("acceptance", network=network) as node:
            yield Case(system, ros, node, RobotDescription.load(instance.settings().robot))
        ros.close()
    assert leftovers(home, system.name, before) == []


def test_every_service_is_ready_and_the_robot_stands(case: Case) -> None:
    status = case.system.status()
    assert {service["name"]: service["state"] for service in status["services"]} == dict.fromkeys(SERVICES, "ready")
    assert status["behavior"] == "stand" and status["control_mode"] == "stand"
    assert status["robot"] == "escher" and status["profile"] == "sim" and status["clock"]["mode"] == "realtime"
    assert all(service["restarts"] == 0 for service in status["services"])


def test_stands_still(case: Case) -> None:
    states, senses, truths = case.watch(STAND)
    assert {state.behavior for state in states} == {"stand"}
    estimated = np.array([state.pelvis_position_in_odom[2] for state in states])
    true = np.array([truth.pelvis_position_in_world for truth in truths])
    assert np.ptp(estimated) < 0.01
    assert np.ptp(true[:, 2]) < 0.01
    # Standing begins where the joints' servos have held the robot: leaning back a little.
    assert np.all(np.ptp(true[SETTLED:], axis=0) < 0.01), "the true pelvis moved"
    positions = np.array([sense.joint_position for sense in senses])
    assert np.all(positions > case.robot.lower) and np.all(positions < case.robot.upper)
    efforts = np.array([sense.joint_effort for sense in senses])
    assert np.all(np.abs(efforts) < 1.05 * case.robot.effort_limit + 1.0)  # measured with noise
    assert states[-1].qp_failures == 0


def test_arm_and_neck_goals_succeed(case: Case) -> None:
    status = case.ros.change_mode("stand_manipulate")
    assert status.status == MODE_ACCEPTED and status.current_control_mode == "stand_manipulate"
    target = case.robot.tables.arm_presets["forward"]["right"]
    answer = case.ros.follow("right_arm", [(4.0, target)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
    neck = {"neck_yaw": 0.5, "neck_pitch": 0.2}
    answer = case.ros.follow("neck", [(2.0, neck)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
    states, senses, _ = case.watch(1.0)
    assert {state.behavior for state in states} == {"stand_manipulate"}
    settled = np.mean([sense.joint_position for sense in senses], axis=0)
    errors = {name: abs(settled[case.robot.index[name]] - value) for name, value in (dict(target) | neck).items()}
    assert max(errors.values()) < 0.02, errors


def test_a_small_push_does_not_topple_it(case: Case) -> None:
    status = case.ros.change_mode("stand")
    assert status.status == MODE_ACCEPTED and status.current_control_mode == "stand"
    for push in PUSHES:
        case.system.valorctl("push", *push)
        states, _, _ = case.watch(4.0)
        assert {state.behavior for state in states} == {"stand"}
        speed = np.abs([state.pelvis_linear_velocity_in_odom for state in states[-250:]])
        assert speed.max() < 0.1


def test_a_large_push_does_and_ros_hears_of_it(case: Case) -> None:
    subscriber = MOTION_STATE.subscriber(case.node, queue=5000)
    case.ros.reports.clear()
    case.system.valorctl("push", "130", "0", "0")

    def falls() -> MotionState | None:
        return next((r.message for r in subscriber.drain() if r.message.behavior == "fall"), None)

    def reported() -> Any:
        return next((report for report in case.ros.reports if report.status & EXTERNAL_CHANGE), None)

    fell = wait_until(falls, 30.0, "130 N·s topple it")
    report = wait_until(reported, 30.0, "the change is reported as external")
    assert report.current_control_mode == "none"
    assert stamp(report) - fell.time < 200_000_000  # robot time, which a busy machine slows down
    assert case.system.status()["behavior"] == "fall"
