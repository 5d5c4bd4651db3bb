"""The Motion System as it runs: bifrostd, Comms Manager and Motion Manager as processes, and a client beside them."""

import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from harness.instance import RunningInstance
from harness.places import ROBOTS
from harness.waiting import wait_until
from tests.integration.motion_system import STANDING, MotionSystem
from tests.integration.shared import left_standing
from valor.common.behaviors import Behavior
from valor.common.messages import BehaviorReply, Footstep, FootstepPlanRequest, JointMode, JointSetpoints, MotionState
from valor.common.topics import BEHAVIOR, FOOTSTEP_PLAN, JOINT_SETPOINTS, PROPRIOCEPTOR
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
ARM = ROBOT.tables.groups["right_arm"]
ARM_PLACES = ROBOT.group_indices("right_arm")
FORWARD = np.array([ROBOT.tables.arm_presets["forward"]["right"][name] for name in ARM])
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
STEP_LENGTH = 0.2  # [m]
FLOODED = f"flooder floods {JOINT_SETPOINTS.name}"
MISSED = 50  # periods in a row that a busy machine may cost


def largest_steps(history: list[MotionState], places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Greatest change of the commanded positions per second of robot time, between consecutive states."""
    time = np.array([state.time for state in history]) * 1e-9
    position = np.array([state.joint_setpoint[places] for state in history])
    elapsed = np.diff(time)[:, None]
    consecutive = (elapsed > 0.0)[:, 0]
    return elapsed[consecutive], np.abs(np.diff(position, axis=0))[consecutive]


@pytest.fixture(scope="module")
def started(module_instance: RunningInstance) -> MotionSystem:
    """One system for the tests below, each of which leaves the robot standing, except the last two."""
    return MotionSystem(module_instance)


@pytest.fixture
def system(started: MotionSystem) -> Iterator[MotionSystem]:
    """The shared system, standing, its history cleared; the test leaves the robot standing."""
    started.stand()
    started.forget()
    with left_standing(started.stand, lambda: started.pass_time(0.1).behavior):
        yield started


def still(state: MotionState) -> bool:
    return bool(state.contacts.all() and np.abs(state.pelvis_linear_velocity_in_odom).max() < 0.01)


def footsteps(first: int, count: int, x: float) -> list[Footstep]:
    """Steps ahead from ``x``, left and right in turn, and a last one beside the one before."""
    steps = []
    for i in range(first, first + count):
        x += STEP_LENGTH if i < first + count - 1 else 0.0
        place = np.array([x, 0.1 if i % 2 == 0 else -0.1, 0.0])
        steps.append(Footstep(i, i % 2, place, LEVEL, 0.0, 0.0, 0.0))
    return steps


def test_takes_a_footstep_plan_changes_it_on_the_way_and_stands(system: MotionSystem) -> None:
    """The first in the shared system: its odometry begins where the robot stands."""
    assert "the behavior is stand" in system.plan(footsteps(0, 4, 0.0)).reason
    system.go(Behavior.STEP)
    far = footsteps(0, 4, 0.0)
    far[2].position_in_odom[0] += 1.0
    refused = system.plan(far)
    assert not refused.accepted and "step 2 (left)" in refused.reason and "forward" in refused.reason
    assert "starts with step 0" in system.plan(footsteps(1, 2, 0.0)).reason
    before = system.place()
    assert system.pass_time(0.3).behavior == Behavior.STEP
    reply = system.plan(footsteps(0, 4, 0.0))
    assert reply.accepted, reply.reason

    def executing(index: int) -> bool:
        status = system.status()
        return status is not None and status.executing_step_index == index

    wait_until(lambda: executing(1), 60.0, "step 1")
    moved = footsteps(1, 2, STEP_LENGTH)
    moved[0].position_in_odom[0] += 0.05
    assert "step 1 cannot be changed" in system.plan(moved).reason
    longer = footsteps(2, 4, 2 * STEP_LENGTH)
    reply = system.plan(longer)
    assert reply.accepted, reply.reason
    system.wait_behavior(Behavior.STAND, 120.0)
    finished: Any = wait_until(
        lambda: (status := system.status()) and status.state == "finished" and status, 10.0, "the plan finished"
    )
    assert finished
    assert (finished.last_performed_step_index, finished.queue_size, finished.executing_step_index) == (5, 0, -1)
    seen = [status.executing_step_index for status in system.statuses if status.executing_step_index >= 0]
    assert sorted(set(seen)) == list(range(6)) and seen == sorted(seen)
    wait_until(lambda: still(system.look() or system.pass_time(0.1)), 60.0, "standing still")
    way = system.place() - before
    assert way[0] == pytest.approx(5 * STEP_LENGTH, abs=0.05) and abs(way[1]) < 0.05
    assert system.height > STANDING and "fall" not in system.behaviors()


def test_walks_by_velocity_and_stops_when_nobody_commands(system: MotionSystem) -> None:
    system.go(Behavior.WALK)
    before, estimated = system.place(), system.pass_time(0.1).pelvis_position_in_odom
    system.walk(0.3, 6.0)
    began = system.now()
    system.wait(lambda state: state.time > began + 3e9 and still(state), "standing still after silence", 120.0)
    state = system.pass_time(1.5)
    assert still(state)
    assert state.behavior == Behavior.WALK  # and waits for the next velocity
    way, believed = system.place() - before, state.pelvis_position_in_odom - estimated
    assert 1.2 < way[0] < 2.6 and abs(way[1]) < 0.2 and np.abs(believed - way).max() < 0.1
    assert system.request("stand").accepted
    system.wait_behavior(Behavior.STAND)
    assert system.height > STANDING
    assert not any(state.qp_failures for state in system.history)
    assert "fall" not in system.behaviors()


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
    assert system.height > STANDING and system.behaviors()[-3:] == ["stand", "stand_manipulate", "stand"]
    assert not any(state.qp_failures for state in system.history)
    arms = np.concatenate((ARM_PLACES, ROBOT.group_indices("left_arm")))
    elapsed, steps = largest_steps(system.history, arms)
    assert (steps <= ROBOT.velocity_limit[arms] * elapsed * 1.05 + 1e-6).all()
    sequences = [state.proprioceptor_sequence for state in system.history]
    assert sequences == sorted(sequences)
    # What is reported of a tick contains the part until its Motor, which the MotionState before reported.
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
    system.refused("is nan, not a finite number", setpoints={"neck_yaw": np.nan})
    system.refused("stale", changes={"age": 1.0})
    reply = system._footsteps.call(
        FootstepPlanRequest(steps=[Footstep(1, 0, np.zeros(3), np.array([1.0, 0, 0, 0]), 0.0, 0.0, 0.0)]), timeout=10.0
    )
    assert not reply.accepted and "step_manipulate; the behavior is stand" in reply.reason
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
    assert np.allclose(system.pass_time(1.0).joint_setpoint[ARM_PLACES], held, atol=0.02) and system.height > STANDING
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
    assert set(system.behaviors()) <= {"stand_prep", "stand"} and system.height > STANDING


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
    assert system.pass_time(1.0).behavior == Behavior.STAND and system.height > STANDING


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
        reported = system._statistics.latest()
        return reported is not None and reported.message.state == "degraded" and FLOODED in reported.message.detail

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
    assert system.go(Behavior.STAND).behavior == Behavior.STAND and system.height > STANDING


def test_pushed_over_the_robot_goes_limp_and_stays_fallen(started: MotionSystem) -> None:
    """The last in the shared system for which it stands."""
    system = started
    system.stand()
    system.forget()
    system.pass_time(1.0)
    system.push((0.0, 80.0, 0.0))
    fallen = system.wait_behavior(Behavior.FALL)
    assert "limit" in fallen.reason
    system.pass_time(3.0)
    assert system.height < 0.5
    motor = wait_until(system.motors.latest, 10.0, "a Motor").message
    assert not motor.effort.any() and not motor.stiffness.any()
    assert set(motor.mode) <= {JointMode.FORCE, JointMode.OFF}
    for behavior in ("stand", "stand_prep", "stand_manipulate", "idle"):
        assert not system.request(behavior).accepted
    assert system.pass_time(0.1).reason == fallen.reason  # still the same
    # Lying on the floor it can be frozen and prepared, and never stands.
    system.go(Behavior.FREEZE)
    system.go(Behavior.STAND_PREP)

    def prepared() -> BehaviorReply | None:
        reply = system.request("stand")
        return None if any(word in reply.reason for word in ("to go", "begun", "silent")) else reply

    reply = wait_until(prepared, 60.0, "Stand Prep done", period=0.1)
    assert not reply.accepted
    assert any(word in reply.reason for word in ("tilted", "foot", "above the soles", "settled")), reply.reason


def test_it_stops_at_once_when_requested(started: MotionSystem) -> None:
    """The last one in the shared system."""
    assert started.instance.stop("motion_manager") == 0 and "Traceback" not in started.instance.log("motion_manager")
