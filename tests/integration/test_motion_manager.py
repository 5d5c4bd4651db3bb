"""The Motion System as it runs: bifrostd, Comms Manager and Motion Manager as processes, and a client beside them."""

from __future__ import annotations

import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from harness.instance import RunningInstance, fresh_instance
from harness.motion_system import STANDING, MotionSystem
from harness.places import ROBOTS
from harness.waiting import wait_until
from valor.common.behaviors import Behavior
from valor.common.messages import (
    BehaviorReply,
    Footstep,
    FootstepPlanRequest,
    JointMode,
    JointSetpoints,
    MotionState,
)
from valor.common.topics import (
    BEHAVIOR,
    FOOTSTEP_PLAN,
    JOINT_SETPOINTS,
    PROPRIOCEPTOR,
)
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
ARM = ROBOT.tables.groups["right_arm"]
ARM_PLACES = ROBOT.group_indices("right_arm")
FORWARD = np.array([ROBOT.tables.arm_presets["forward"]["right"][name] for name in ARM])
FLOODED = f"flooder floods {JOINT_SETPOINTS.name}"
MISSED = 50  # periods in a row that a busy machine may cost


def largest_steps(history: list[MotionState], places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Greatest change of the commanded positions per second of robot time, between consecutive states."""
    time = np.array([state.time for state in history]) * 1e-9
    position = np.array([state.joint_setpoint[places] for state in history])
    elapsed = np.diff(time)[:, None]
    consecutive = (elapsed > 0.0)[:, 0]
    return elapsed[consecutive], np.abs(np.diff(position, axis=0))[consecutive]


def test_the_motion_system_runs_where_ros_cannot_be_imported(instance: RunningInstance, tmp_path: Path) -> None:
    marker = tmp_path / "blocked"
    (tmp_path / "sitecustomize.py").write_text(
        "import pathlib, os, sys\n"
        "ROS = {'rclpy', 'rosidl_runtime_py', 'std_msgs', 'sensor_msgs', 'builtin_interfaces', 'ament_index_python'}\n"
        "class Blocker:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.split('.')[0] in ROS:\n"
        "            raise ModuleNotFoundError(f'No module named {name!r}: ROS is not installed here')\n"
        "sys.meta_path.insert(0, Blocker())\n"
        f"pathlib.Path({str(marker)!r} + f'-{{os.getpid()}}').touch()\n"
    )
    system = MotionSystem(instance, env={"PYTHONPATH": str(tmp_path)})
    for name in ("comms_manager", "motion_manager"):
        assert Path(f"{marker}-{instance.process(name).pid}").exists(), f"{name} ran without the blocker"
    system.stand()
    system.pass_time(1.0)
    assert system.height > STANDING


@pytest.fixture(scope="module")
def started() -> Iterator[MotionSystem]:
    """One system for those behind, each of which leaves the robot standing; but for the last two."""
    with (
        tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as home,
        fresh_instance(Path(home)) as running,
    ):
        yield MotionSystem(running)


@pytest.fixture
def system(started: MotionSystem) -> MotionSystem:
    """It, standing; what others have seen of it is forgotten."""
    started.stand()
    started.forget()
    return started


def test_stand_prep_answers_why_stand_is_refused(system: MotionSystem) -> None:
    assert system.request("stand_prep").accepted
    refusals = []

    def accepted() -> bool:
        reply = system.request("stand")
        if not reply.accepted:
            assert reply.behavior == Behavior.STAND_PREP
            refusals.append(reply.reason)
        return reply.accepted

    wait_until(accepted, 60.0, "stand accepted")
    assert refusals
    assert all("stand_prep" in reason or "foot" in reason for reason in refusals), refusals


def test_escher_gets_ready_stands_gives_its_arms_away_and_takes_them_back(system: MotionSystem) -> None:
    system.pass_time(1.0)
    system.go(Behavior.STAND_MANIPULATE)
    held = system.pass_time(0.5).joint_setpoint[ARM_PLACES]
    assert np.allclose(held, ROBOT.nominal_posture[ARM_PLACES], atol=0.03)  # nobody led them yet
    arrived = system.lead(
        dict(zip(ARM, FORWARD, strict=True)),
        lambda state: bool(np.allclose(state.joint_setpoint[ARM_PLACES], FORWARD, atol=0.05)),
        "the right arm forward",
    )
    assert arrived.behavior == Behavior.STAND_MANIPULATE
    system.go(Behavior.STAND)
    system.wait(
        lambda state: bool(np.allclose(state.joint_setpoint[ARM_PLACES], ROBOT.nominal_posture[ARM_PLACES], atol=0.05)),
        "the right arm at home",
    )
    assert system.height > STANDING
    assert system.behaviors()[-3:] == ["stand", "stand_manipulate", "stand"]
    assert not any(state.qp_failures for state in system.history)
    arms = np.concatenate((ARM_PLACES, ROBOT.group_indices("left_arm")))
    elapsed, steps = largest_steps(system.history, arms)
    assert (steps <= ROBOT.velocity_limit[arms] * elapsed * 1.05 + 1e-6).all()
    sequences = [state.proprioceptor_sequence for state in system.history]
    assert sequences == sorted(sequences)
    # What is told of a tick contains the part until its Motor, which the MotionState before told.
    pairs = [
        (before.motor_time, state.tick_time)
        for before, state in zip(system.history, system.history[1:], strict=False)
        if state.proprioceptor_sequence == before.proprioceptor_sequence + 1
    ]
    assert len(pairs) > 100 and all(0.0 < motor_time < tick_time for motor_time, tick_time in pairs)


def test_commands_are_refused_with_their_reasons_and_the_robot_stands_on(system: MotionSystem) -> None:
    assert "unknown behavior 'moonwalk'; expected one of idle, stand_prep" in system.request("moonwalk").reason
    assert "no transition from stand to idle" in system.request("idle").reason
    before = system.pass_time(1.0).joint_setpoint
    arm = dict.fromkeys(ARM, 0.0)
    system.refused("closed to set-points in behavior stand: manipulation is slave", setpoints=arm)
    system.refused("they carry the robot", setpoints={"l_knee_pitch": 1.0})
    system.refused("unknown joint 'tail'", setpoints={"tail": 1.0})
    system.refused("is nan, not a finite number", setpoints={"neck_yaw": np.nan})
    system.refused("position has 3 numbers", changes={"position": np.zeros(3)})
    system.refused("stale", changes={"age": 1.0})
    reply = system._footsteps.call(
        FootstepPlanRequest(steps=[Footstep(1, 0, np.zeros(3), np.array([1.0, 0, 0, 0]), 0.0, 0.0, 0.0)]), timeout=10.0
    )
    assert not reply.accepted
    assert "step_manipulate; the behavior is stand" in reply.reason
    after = system.pass_time(0.5)
    assert after.behavior == Behavior.STAND
    arms = np.concatenate((ARM_PLACES, ROBOT.group_indices("left_arm"), ROBOT.group_indices("neck")))
    assert np.allclose(after.joint_setpoint[arms], before[arms], atol=0.02)
    assert system.height > STANDING
    refused = {rejection.topic: rejection.count for rejection in system.rejections}
    assert set(refused) == {BEHAVIOR.name, JOINT_SETPOINTS.name, FOOTSTEP_PLAN.name}
    wait_until(lambda: system.counts_at_least(sum(refused.values())), 20.0, "all are counted")


def test_soft_stop_keeps_balance_and_closes_the_interfaces(system: MotionSystem) -> None:
    system.go(Behavior.STAND_MANIPULATE)
    system.lead(dict(zip(ARM, FORWARD, strict=True)), lambda s: s.joint_setpoint[ARM_PLACES[0]] < 0.1, "an arm moved")
    system.go(Behavior.SOFT_STOP)
    held = system.pass_time(1.0).joint_setpoint[ARM_PLACES]
    system.refused("soft_stop: attention is locked", setpoints={"neck_yaw": 0.1})
    system.refused("soft_stop: manipulation is locked", setpoints=dict(zip(ARM, FORWARD, strict=True)))
    assert np.allclose(system.pass_time(1.0).joint_setpoint[ARM_PLACES], held, atol=0.02)
    assert system.height > STANDING
    system.go(Behavior.STAND)
    system.pass_time(1.0)
    assert system.height > STANDING


@pytest.mark.parametrize("posture", [Behavior.STAND_PREP, Behavior.FREEZE])
def test_a_standing_robot_is_handed_to_its_servos_without_a_fall_and_back(
    system: MotionSystem, posture: Behavior
) -> None:
    height = system.pass_time(2.0).pelvis_position_in_odom[2]
    system.go(posture)
    begun = len(system.history)
    system.pass_time(0.3)
    lowest = min(state.pelvis_position_in_odom[2] for state in system.history[begun:])
    assert lowest > height - 0.01
    system.go(Behavior.STAND_PREP)
    system.stand()
    system.pass_time(1.0)
    assert system.height > STANDING


@pytest.mark.parametrize("name", ["motion_manager", "comms_manager"])
def test_a_process_that_stands_still_for_a_moment_is_no_fall(system: MotionSystem, name: str) -> None:
    system.pass_time(0.5)
    process = system.instance.process(name)
    process.send_signal(signal.SIGSTOP)
    try:
        time.sleep(0.3)  # the stall is the subject of this test
    finally:
        process.send_signal(signal.SIGCONT)
    system.pass_time(1.0)
    assert set(system.behaviors()) <= {"stand_prep", "stand"}
    assert system.height > STANDING


def test_proprioceptors_of_another_node_are_not_taken_for_the_robot(system: MotionSystem) -> None:
    recorded = PROPRIOCEPTOR.subscriber(system.instance.node("other"))
    said = wait_until(recorded.latest, 20.0, "a Proprioceptor").message
    replayed = PROPRIOCEPTOR.publisher(system.instance.node("player"))

    def play() -> bool:
        said.sequence, said.time, said.imu_orientation = 1, 1, np.array([0.0, 1.0, 0.0, 0.0])
        replayed.publish(said)
        system.look()
        return any("comes from player; expected comms_manager" in rejection.reason for rejection in system.rejections)

    wait_until(play, 20.0, "the replay refused")
    assert system.pass_time(1.0).behavior == Behavior.STAND
    assert system.height > STANDING


def test_who_floods_is_named_and_muted_while_the_motors_go_on(system: MotionSystem) -> None:
    """As many set-points as a loop can send; another sender leads the arm meanwhile."""
    system.go(Behavior.STAND_MANIPULATE)
    flooder = JOINT_SETPOINTS.publisher(system.instance.node("flooder"))
    nothing = np.zeros(1)
    stale = JointSetpoints(time=1, names=["neck_yaw"], position=nothing, velocity=nothing, acceleration=nothing)
    stop = threading.Event()

    def flood() -> None:
        while not stop.is_set():
            flooder.publish(stale)

    def named() -> bool:
        told = system._statistics.latest()
        return told is not None and told.message.state == "degraded" and FLOODED in told.message.detail

    thread = threading.Thread(target=flood)
    system.forget()
    thread.start()
    try:
        wait_until(named, 20.0, "the flooder is named")
        system.lead(
            dict(zip(ARM, FORWARD, strict=True)),
            lambda state: bool(np.allclose(state.joint_setpoint[ARM_PLACES], FORWARD, atol=0.05)),
            "the right arm forward, led by another",
        )
    finally:
        stop.set()
        thread.join()
    periods = np.diff([state.proprioceptor_sequence for state in system.history])
    assert periods.max() <= MISSED, f"{periods.max()} periods without a Motor"
    assert system.go(Behavior.STAND).behavior == Behavior.STAND
    assert system.height > STANDING


def test_pushed_over_the_robot_goes_limp_and_stays_fallen(system: MotionSystem) -> None:
    """The last in the shared system for which it stands."""
    system.pass_time(1.0)
    system.push((0.0, 80.0, 0.0))
    fallen = system.wait_behavior(Behavior.FALL)
    assert "limit" in fallen.reason
    system.pass_time(3.0)
    assert system.height < 0.5
    motor = wait_until(system.motors.latest, 10.0, "a Motor").message
    assert not motor.effort.any()
    assert not motor.stiffness.any()
    assert set(motor.mode) <= {JointMode.FORCE, JointMode.OFF}
    for behavior in ("stand", "stand_prep", "stand_manipulate", "idle"):
        assert not system.request(behavior).accepted
    assert "face-down only" in system.request("get_up").reason  # it fell on its side
    assert system.pass_time(0.1).reason == fallen.reason  # still the same
    # Lying on the floor it can be frozen and prepared, and never stands.
    system.go(Behavior.FREEZE)
    system.go(Behavior.STAND_PREP)

    def prepared() -> BehaviorReply | None:
        reply = system.request("stand")
        return None if any(word in reply.reason for word in ("to go", "begun", "silent")) else reply

    reply = wait_until(prepared, 60.0, "Stand Prep done", period=0.1)
    assert reply is not None
    assert not reply.accepted
    assert any(word in reply.reason for word in ("tilted", "foot", "above the soles", "settled")), reply.reason


def test_it_stops_at_once_when_told(started: MotionSystem) -> None:
    """The last one in the shared system."""
    assert started.instance.stop("motion_manager") == 0
    assert "Traceback" not in started.instance.log("motion_manager")
