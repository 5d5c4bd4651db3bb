"""ESCHER stands, reaches and is pushed: the whole system, as a person and a ROS 2 client meet it.

The plant's masses are 5 % off the controller's model, sensors are noisy, torques late (profile ``hardware``), in both
clocks, each from a seed of its own.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bifrost
from harness.system import RosClient, System, leftovers, running, shared_memory
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import resting, stamp
from valor.analysis.results import Result
from valor.common.instance import Instance
from valor.common.messages import GroundTruth, MotionState, Proprioceptor
from valor.common.processes import BY_NAME as PROCESSES_BY_NAME
from valor.common.topics import GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.valorctl import startup
from valor.valorctl.console import Progress
from valor.valorctl.experiments.experiment import Options
from valor.valorctl.experiments.table import BY_NAME
from valor.valorctl.interruption import Interruption

SERVICES = {
    "bifrostd", "motion_manager", "comms_manager", "valor_ros_controller", "footstep_converter", "bag_recorder",
}  # fmt: skip
# Code and flag values of the public interfaces (control_msgs, vigir_humanoid_control_msgs).
SUCCESSFUL, INVALID_GOAL, INVALID_JOINTS = 0, -1, -2
MODE_ACCEPTED, MODE_REJECTED, EXTERNAL_CHANGE = 1, 2, 32

CASES = [("lockstep", 0), ("realtime", 1)]  # clock, seed
STAND = 10.0  # [s]
SETTLED = 300  # samples of the truth, at 100 Hz, after which the robot is where its controller wants it
PUSHES = {0: (("15", "0", "0"),), 1: (("-15", "0", "0"), ("0", "15", "0"))}  # by seed [N·s]


@dataclass
class Case:
    """A running system, a ROS client of it and a Bifrost node that watches it."""

    system: System
    home: Path
    ros: RosClient
    node: bifrost.Node
    robot: RobotDescription
    seed: int

    def watch(self, seconds: float) -> tuple[list[MotionState], list[Proprioceptor], list[GroundTruth]]:
        """All that is published in a stretch of robot time [s]."""
        states = MOTION_STATE.subscriber(self.node, queue=5000)
        senses = PROPRIOCEPTOR.subscriber(self.node, queue=5000)
        truths = GROUND_TRUTH.subscriber(self.node, queue=5000)
        kept: tuple[list[MotionState], list[Proprioceptor], list[GroundTruth]] = ([], [], [])
        deadline = time.monotonic() + 60.0 + 20.0 * seconds
        while time.monotonic() < deadline:
            bifrost.wait([states], timeout=0.5)
            pairs: Any = zip((states, senses, truths), kept, strict=True)
            for subscriber, messages in pairs:
                messages.extend(received.message for received in subscriber.drain())
            if kept[0] and kept[0][-1].time - kept[0][0].time >= seconds * 1e9:
                break
            time.sleep(0.05)  # let a batch gather
        else:
            raise AssertionError(f"{seconds:g} s of robot time did not pass; {len(kept[0])} motion states came")
        for subscriber in (states, senses, truths):
            subscriber.close()
        return kept

    def arm_goal(self, joints: dict[str, float], after: float = 2.5) -> list[tuple[float, dict[str, float]]]:
        """A trajectory of one point that names every joint of the right arm."""
        posture = {name: joints.get(name, 0.0) for name in self.robot.tables.groups["right_arm"]}
        return [(after, posture | {name: value for name, value in joints.items() if name not in posture})]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: f"{case[0]}-seed{case[1]}")
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Case]:
    clock, seed = request.param
    home = tmp_path_factory.mktemp("v")
    before = shared_memory()
    options = ("--clock", clock, "--seed", str(seed), "--actuators", "hardware")
    with running(f"stands-{clock}-{seed}", home, *options) as system:
        ros = RosClient(system.join(), joint_states=False)
        instance = Instance(system.name, home)
        network = bifrost.Network.load(instance.network_file, instance.keys)
        with bifrost.Node("acceptance", network=network) as node:
            yield Case(system, home, ros, node, RobotDescription.load(instance.settings().robot), seed)
        ros.close()
    assert leftovers(home, system.name, before) == []


def test_every_service_is_ready_and_the_robot_stands(case: Case) -> None:
    status = case.system.status()
    assert {service["name"]: service["state"] for service in status["services"]} == dict.fromkeys(SERVICES, "ready")
    assert status["behavior"] == "stand" and status["control_mode"] == "stand"
    assert status["robot"] == "escher" and status["profile"] == "sim"
    assert status["clock"]["mode"] in ("lockstep", "realtime")
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


def test_arm_goals_are_refused_in_stand(case: Case) -> None:
    before = resting(case.ros)
    answer = case.ros.follow("right_arm", case.arm_goal({"r_shoulder_pitch": -0.5}))
    assert answer.result.error_code == INVALID_GOAL
    assert "stand" in answer.result.error_string and "right_arm" in answer.result.error_string
    assert_arm_unmoved(case, before)


def assert_within_budgets(rows: dict[str, list[float]], factor: float) -> None:
    """Memory at its most; of the processor, seconds a second of robot time, three times as many on a busy computer."""
    for name, (mean, *_, most) in rows.items():
        budget = PROCESSES_BY_NAME[name]
        assert most <= budget.memory_budget, f"{name}: {most:.0f} MiB"
        assert mean / factor <= 3.0 * budget.cpu_budget, f"{name}: {mean:.0f} % at {factor:.2f} of real time"


@pytest.mark.parametrize("case", CASES[:1], indirect=True, ids=["lockstep-seed0"])
def test_an_experiment_tells_what_each_process_takes(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the system that stands, in the place of one of its own."""
    instance = Instance(case.system.name, case.home)
    monkeypatch.setattr(startup, "running", lambda *_: nullcontext(instance.settings()))
    experiment, options = BY_NAME["process-stats"], Options(tmp_path, quick=True)
    result, file = experiment.perform(instance, options, Progress(), Interruption())
    assert Result.load(file.parent) == result
    (table,) = result.tables
    rows = {row[0]: [float(value) for value in row[1:]] for row in table.rows}
    assert set(rows) >= SERVICES
    for name, (mean, deviation, largest, smallest, memory, most) in rows.items():
        assert 0.0 <= smallest <= mean <= largest and 0.0 <= deviation <= largest - smallest + 0.1, name
        assert 1.0 < memory <= most, name
    assert rows["motion_manager"][0] > 1.0, "it controls a robot all the while"
    numbers = {measure.name: measure.value for measure in result.measures}
    assert numbers["VRC memory, mean"] == pytest.approx(rows["valor_ros_controller"][4], abs=0.1)
    assert numbers["whole system, mean"] == pytest.approx(sum(row[0] for row in rows.values()), abs=0.1 * len(rows))
    factor = numbers["robot time against the wall's"] or 0.0
    assert factor > 0.0
    assert_within_budgets(rows, factor)
    with open(tmp_path / "process_stats.csv") as opened:
        assert len(opened.readlines()) > 3
    assert all((tmp_path / picture.file).stat().st_size > 5_000 for picture in result.pictures)


def test_stand_manipulate_and_bad_goals(case: Case) -> None:
    status = case.ros.change_mode("stand_manipulate")
    assert status.status == MODE_ACCEPTED and status.current_control_mode == "stand_manipulate"
    before = resting(case.ros)
    unknown = case.ros.follow("right_arm", case.arm_goal({"r_tail_wag": 0.1}))
    assert unknown.result.error_code == INVALID_JOINTS and "r_tail_wag" in unknown.result.error_string
    nan = case.ros.follow("right_arm", case.arm_goal({"r_elbow_pitch": math.nan}))
    assert nan.result.error_code == INVALID_GOAL and "r_elbow_pitch" in nan.result.error_string
    assert_arm_unmoved(case, before)


def test_arm_and_neck_goals_succeed(case: Case) -> None:
    target = case.robot.tables.arm_presets["forward"]["right"]
    answer = case.ros.follow("right_arm", case.arm_goal(dict(target), after=4.0))
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
    for push in PUSHES[case.seed]:
        case.system.valorctl("push", *push)
        states, _, _ = case.watch(4.0)
        assert {state.behavior for state in states} == {"stand"}
        speed = np.abs([state.pelvis_linear_velocity_in_odom for state in states[-250:]])
        assert speed.max() < 0.1


def test_a_large_push_does_and_ros_hears_of_it(case: Case) -> None:
    subscriber = MOTION_STATE.subscriber(case.node, queue=5000)
    case.ros.reports.clear()
    case.system.valorctl("push", "80", "0", "0")

    def falls() -> MotionState | None:
        return next((r.message for r in subscriber.drain() if r.message.behavior == "fall"), None)

    def reported() -> Any:
        return next((report for report in case.ros.reports if report.status & EXTERNAL_CHANGE), None)

    fell = wait_until(falls, 30.0, "80 N·s topple it")
    report = wait_until(reported, 30.0, "the change is reported as external")
    assert report.current_control_mode == "none"
    assert stamp(report) - fell.time < 200_000_000  # robot time, which a busy machine slows down
    assert case.system.status()["behavior"] == "fall"


def assert_arm_unmoved(case: Case, before: dict[str, float]) -> None:
    """Every joint of the right arm is where it was, over half a second of robot time."""
    _, senses, _ = case.watch(0.5)
    for name in case.robot.tables.groups["right_arm"]:
        index = case.robot.index[name]
        moved = max(abs(sense.joint_position[index] - before[name]) for sense in senses)
        assert moved < 0.02, f"{name} moved by {moved:.3f} rad"
