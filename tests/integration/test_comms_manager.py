"""The Comms Manager's simulation as a process: clocks, silence, refusals, pushes, restarts."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import bifrost
from harness.comms_manager_alone import Newest, Watch, client_process, start
from harness.instance import RunningInstance
from harness.places import REPOSITORY
from harness.servo_client import ServoClient
from harness.waiting import wait_until
from valor.common.messages import (
    GroundTruth,
    JointMode,
    Motor,
    Proprioceptor,
    PushReply,
    PushRequest,
)
from valor.common.processes import EXIT_CONFIGURATION
from valor.common.topics import (
    MOTOR,
    PROPRIOCEPTOR,
    PUSH,
)
from valor.comms_manager.simulation.clock import BACKLOG
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(REPOSITORY / "robots" / "escher")
WEIGHT = 75.9 * 9.81


class Pusher:
    """A client of ``simulation/push``."""

    def __init__(self, node: bifrost.Node) -> None:
        self._client = PUSH.client(node)

    def __call__(self, *impulse: float, duration: float = 0.0) -> PushReply:
        request = PushRequest(impulse_in_world=np.array(impulse, float), duration=duration)
        return self._client.call(request, timeout=10.0)


def upright(truth: GroundTruth) -> bool:
    """Standing near the nominal posture, on both feet."""
    _, x, y, _ = truth.pelvis_orientation_in_world
    return bool(truth.com_in_world[2] > 0.83 and 1 - 2 * (x * x + y * y) > 0.99 and truth.contacts.all())


@pytest.mark.parametrize("actuators", ["ideal", "hardware"])
def test_stands_passively_for_twenty_seconds(instance: RunningInstance, actuators: str) -> None:
    start(instance, actuators=actuators)
    node = instance.node()
    watch, proprioceptor = Watch(node), Newest(node, PROPRIOCEPTOR)
    with client_process(instance):
        settled = watch.truth_at(5.0)
        truth, state, clock = watch.truth_at(20.0, timeout=400.0), proprioceptor(), watch.clock()
    assert upright(truth)
    assert np.abs(truth.com_in_world - settled.com_in_world).max() < 0.002
    assert np.abs(state.joint_velocity).max() < 0.2
    total = state.left_foot_wrench[2] + state.right_foot_wrench[2]
    assert total == pytest.approx(WEIGHT, rel=0.06)
    assert clock.waits_timed_out == 0
    assert not clock.holding


def test_nothing_moves_before_the_first_motor(instance: RunningInstance) -> None:
    start(instance)
    node = instance.node()
    watch, client = Watch(node), ServoClient(node, ROBOT)
    first = client.hear()
    again = [client.hear() for _ in range(5)]
    assert all(state == first for state in again)
    assert (first.time, first.motor_sequence) == (0, 0)
    wait_until(lambda: "first Motor" in watch.statistics().detail, 10, "it says what it waits for")
    assert not watch.clock().holding
    np.testing.assert_allclose(first.joint_position, ROBOT.nominal_posture, atol=0.002)
    refused = Pusher(node)(10.0, 0.0, 0.0)
    assert not refused.accepted
    assert "not begun" in refused.reason
    assert client.run_to(0.1).sequence == first.sequence + 50


@pytest.mark.parametrize("real_time_factor", [0.0, 1.0])
def test_lockstep_repeats_bit_for_bit(instance: RunningInstance, real_time_factor: float) -> None:
    """The whole loop, feedback included: the client's posture depends on what it measures."""

    class Reflex(ServoClient):
        def command(self, state: Proprioceptor) -> Motor:
            motor = super().command(state)
            motor.position = motor.position - 0.1 * (state.joint_position - motor.position)
            return motor

    runs = []
    for _ in range(2):
        start(instance, seed=7, real_time_factor=real_time_factor)
        client = Reflex(instance.node(), ROBOT, keep=True)
        client.run_to(1.0)
        instance.stop("comms_manager")
        states: dict[int, list[bytes]] = {}
        for state in client.states:
            states[state.time] = [
                getattr(state, name).tobytes()
                for name in ("joint_position", "joint_velocity", "joint_effort", "imu_orientation",
                             "imu_angular_velocity", "imu_linear_acceleration", "left_foot_wrench",
                             "right_foot_wrench", "left_hand_wrench", "right_hand_wrench")
            ]  # fmt: skip
        runs.append(states)
    assert len(runs[0]) == 501
    assert runs[0] == runs[1]


def test_lockstep_is_paced_to_real_time(instance: RunningInstance) -> None:
    start(instance, real_time_factor=2.0)
    node = instance.node()
    watch, client = Watch(node), ServoClient(node, ROBOT)
    watch.clock()
    client.run_to(0.4)
    before = time.perf_counter()
    begun = client.run_to(0.5)
    between, slip = time.perf_counter(), watch.clock().slip
    end = client.run_to(3.5)
    after = time.perf_counter()
    robot = (end.time - begun.time) * 1e-9
    assert robot <= 2.0 * (after - before + BACKLOG) + 0.05
    said: Any = wait_until(lambda: (c := watch.clock()).time >= end.time and c, 30, "the clock's word on all of it")
    assert robot + said.slip - slip >= 2.0 * (after - between - BACKLOG - 0.25)  # what it lacks is slip, or is made up


def test_silence_holds_the_joints_and_a_new_motor_ends_it(instance: RunningInstance) -> None:
    start(instance)
    node = instance.node()
    watch, client = Watch(node), ServoClient(node, ROBOT)
    state = client.run_to(1.0)
    sent = client.sequence
    wait_until(lambda: watch.clock().holding, 30, "the joints are held")
    held = watch.truth()
    assert upright(held)
    # Robot time goes on, at the wall's pace although none was set, and the robot stands.
    later = watch.truth_at(held.time * 1e-9 + 2)
    assert upright(later)
    assert np.abs(later.joint_position - held.joint_position).max() < 0.05
    assert client.hear().motor_sequence == sent
    assert "held" in instance.log("comms_manager")
    wait_until(lambda: watch.statistics().detail == f"{MOTOR.name}: silent", 30, "who is silent is named")
    # A Motion Manager that starts anew counts from one.
    fresh = ServoClient(node, ROBOT)
    fresh.answer_until(lambda s: s.time > later.time + 2e9 and not watch.clock().holding)
    assert fresh.hear().time > state.time


def spoil(field: str, value: object) -> Callable[[Motor], None]:
    def change(motor: Motor) -> None:
        if isinstance(value, float):
            vector = getattr(motor, field).copy()
            vector[5] = value
            setattr(motor, field, vector)
        else:
            setattr(motor, field, value)

    return change


UNSOUND = {
    "not finite: position": spoil("position", float("nan")),
    "not finite: velocity": spoil("velocity", float("inf")),
    "not finite: effort": spoil("effort", float("-inf")),
    "not finite: stiffness": spoil("stiffness", float("nan")),
    "not finite: damping": spoil("damping", float("nan")),
    "wrong length": spoil("position", np.zeros(37)),
    "wrong length: mode": spoil("mode", np.zeros(0, np.uint8)),
    "unknown mode": spoil("mode", np.full(38, 4, np.uint8)),
    "negative gain": spoil("damping", -1.0),
    "answers no state of this world": spoil("proprioceptor_sequence", 1),
    "answers no state of this world: the future": spoil("proprioceptor_sequence", 2**62),
    "of an older Motion Manager": spoil("writer", 1),
}


def test_unsound_motors_are_refused_whole_and_move_nothing(instance: RunningInstance) -> None:
    start(instance, actuators="ideal")
    node = instance.node()
    watch, client = Watch(node), ServoClient(node, ROBOT)
    state = client.run_to(0.5)
    before = watch.statistics().rejected
    for kind, change in UNSOUND.items():
        bad = client.command(state)
        bad.mode = np.full(38, JointMode.FORCE, dtype=np.uint8)
        bad.effort = np.full(38, 100.0)  # were it obeyed, the robot would be thrown over
        change(bad)
        client.publish(bad)
        good = client.command(state)
        client.publish(good)
        # The world goes on with the good one, which shows that the other was not obeyed and was not waited for.
        after = client.answer_until(lambda s, sent=good.sequence: s.motor_sequence >= sent)  # type: ignore[misc]
        assert after.motor_sequence >= good.sequence, kind
        assert np.abs(after.joint_effort).max() < 150, kind
        client.publish(client.command(after))  # the world waits for an answer to each of its states
        state = client.run_to(after.time * 1e-9 + 0.05)
    client.publish(client.command(state))
    client.answer_until(lambda _: watch.statistics().rejected - before == len(UNSOUND))
    assert upright(watch.truth())
    log = instance.log("comms_manager")
    assert log.count(" refused: ") == len({kind.partition(":")[0] for kind in UNSOUND}), log  # once a kind
    for kind in UNSOUND:
        assert kind.partition(":")[0] in log


def test_a_push_moves_the_robot_and_bad_ones_are_refused(instance: RunningInstance) -> None:
    start(instance)
    node = instance.node()
    watch, push = Watch(node), Pusher(node)
    with client_process(instance):
        before = watch.truth_at(5.0)
        for impulse, duration, reason in (
            ((np.nan, 0, 0), 0.1, "impulse_in_world"),
            ((0, np.inf, 0), 0.1, "impulse_in_world"),
            ((0, 501, 0), 0.1, "at most 500"),
            ((1, 2), 0.1, "expected 3"),
            ((1, 0, 0), np.nan, "duration"),
            ((1, 0, 0), -0.1, "duration"),
            ((1, 0, 0), 2.1, "up to 2"),
        ):
            reply = push(*impulse, duration=duration)
            assert not reply.accepted
            assert reason in reply.reason
        quiet = watch.truth()
        assert np.abs(quiet.com_in_world - before.com_in_world).max() < 0.002
        reply = push(0.0, 8.0, 0.0)
        assert reply.accepted, reply.reason
        assert reply.time >= quiet.time
        moved = wait_until(
            lambda: (t := watch.truth()).com_in_world[1] > quiet.com_in_world[1] + 0.003 and t, 30, "sways left"
        )
        assert moved.time < reply.time + 1e9
        back = watch.truth_at(reply.time * 1e-9 + 4)
        assert upright(back)
        assert abs(back.com_in_world[1] - quiet.com_in_world[1]) < 0.003


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_waits_out_a_stopped_controller_and_never_replays(instance: RunningInstance, clock: str) -> None:
    start(instance, clock=clock, real_time_factor=1.0)
    node = instance.node()
    watch = Watch(node)
    with client_process(instance) as process:
        watch.truth_at(1.0)
        before = watch.clock.received()
        assert before.message.mode == clock
        os.kill(process.pid, signal.SIGSTOP)
        time.sleep(0.4)  # the stall is the subject of this test
        os.kill(process.pid, signal.SIGCONT)
        until = before.message.time + 1e9
        after: Any = wait_until(
            lambda: (c := watch.clock.received()).message.time > until and c, 30, "1 s of robot time passes"
        )
        slip = after.message.slip - before.message.slip
        assert slip >= 0.4 * 0.9, "robot time stood while the controller did"
        # Robot time and slip account for the wall's time, from one word to the other: nothing was replayed but what was
        # late before the stall.
        passed, elapsed = after.message.time - before.message.time, after.stamp - before.stamp
        assert passed * 1e-9 + slip <= elapsed * 1e-9 + BACKLOG + 0.1
        assert not after.message.holding
        assert upright(watch.truth())


def test_realtime_holds_when_the_controller_is_gone(instance: RunningInstance) -> None:
    start(instance, clock="realtime")
    watch = Watch(instance.node())
    with client_process(instance):
        watch.truth_at(1.0)
    gone = watch.truth()
    wait_until(lambda: watch.clock().holding, 30, "the joints are held")
    later = watch.truth_at(gone.time * 1e-9 + 1)
    assert upright(later)
    assert "nobody publishes Motor" in instance.log("comms_manager")


def test_motors_for_an_earlier_world_are_not_obeyed(instance: RunningInstance) -> None:
    start(instance)
    node = instance.node()
    client = ServoClient(node, ROBOT)
    old = client.run_to(0.5)
    instance.kill("comms_manager")
    start(instance)
    watch = Watch(node)
    state = client.answer_until(lambda s: s.time == 0 and s.sequence != old.sequence)
    assert state.sequence > old.sequence
    for _ in range(20):
        client.publish(client.command(old))
        assert client.hear() == state  # the new world still stands by
    wait_until(lambda: watch.statistics().rejected > 0, 10, "they are counted")
    assert client.run_to(0.1).time >= 0.1e9


@pytest.mark.parametrize(
    ("setting", "value", "message"),
    [
        ("world", "moon", "world 'moon': expected one of flat"),
        ("actuators", "perfect", "actuators 'perfect'"),
        ("real_time_factor", -1.0, "real_time_factor -1"),
    ],
)
def test_bad_settings_end_it_with_one_line(
    instance: RunningInstance, setting: str, value: object, message: str
) -> None:
    instance.configure(**{setting: value})
    process = instance.start("comms_manager")
    assert process.wait(30) == EXIT_CONFIGURATION
    lines = instance.log("comms_manager").strip().splitlines()
    assert len(lines) == 1
    assert message in lines[0]


def test_stops_when_told_while_standing_by_waiting_and_running(instance: RunningInstance) -> None:
    start(instance)
    assert instance.stop("comms_manager") == 0
    start(instance)
    client = ServoClient(instance.node(), ROBOT)
    client.run_to(0.2)
    assert instance.stop("comms_manager") == 0
    assert "Traceback" not in instance.log("comms_manager")
