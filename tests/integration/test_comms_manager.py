"""The Comms Manager's simulation as a process: clocks, silence, refusals, pushes, restarts."""

import os
import signal
import time
from typing import Any

import numpy as np
import pytest

import bifrost
from harness.instance import RunningInstance
from harness.places import REPOSITORY
from harness.waiting import wait_until
from tests.integration.comms_manager_alone import Newest, Watch, client_process, start
from tests.integration.servo_client import ServoClient
from valor.common import messages
from valor.common.behaviors import Behavior
from valor.common.messages import BehaviorRequest, GroundTruth, JointMode, Motor, Proprioceptor, PushReply, PushRequest
from valor.common.processes import EXIT_CONFIGURATION
from valor.common.topics import MOTOR, PAUSED, PROPRIOCEPTOR, PUSH, SIMULATED_TIME, STOP
from valor.comms_manager.simulation.clock import BACKLOG
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(REPOSITORY / "robots" / "escher")
WEIGHT = 75.9 * 9.81


class Pusher:
    def __init__(self, node: bifrost.Node) -> None:
        self._client = PUSH.client(node)

    def __call__(self, *impulse: float, duration: float = 0.0) -> PushReply:
        request = PushRequest(impulse_in_world=np.array(impulse, float), duration=duration)
        return self._client.call(request, timeout=10.0)


def upright(truth: GroundTruth) -> bool:
    """Standing near the nominal posture, on both feet."""
    _, x, y, _ = truth.pelvis_orientation_in_world
    return bool(truth.com_in_world[2] > 0.83 and 1 - 2 * (x * x + y * y) > 0.99 and truth.contacts.all())


def test_stands_passively(instance: RunningInstance) -> None:
    start(instance)
    node = instance.node()
    watch, proprioceptor = Watch(node), Newest(node, PROPRIOCEPTOR)
    with client_process(instance):
        settled = watch.truth_at(5.0)
        truth, state, clock = watch.truth_at(10.0, timeout=400.0), proprioceptor(), watch.clock()
    assert upright(truth) and np.abs(truth.com_in_world - settled.com_in_world).max() < 0.002
    assert np.abs(state.joint_velocity).max() < 0.2
    total = state.left_foot_wrench[2] + state.right_foot_wrench[2]
    assert total == pytest.approx(WEIGHT, rel=0.06)
    assert clock.waits_timed_out == 0 and not clock.holding


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
    assert not refused.accepted and "has not started" in refused.reason
    assert client.run_to(0.1).sequence == first.sequence + 50


def test_lockstep_repeats_bit_for_bit(instance: RunningInstance) -> None:
    """The whole loop, feedback included: the client's posture depends on what it measures."""

    class Reflex(ServoClient):
        def command(self, state: Proprioceptor) -> Motor:
            motor = super().command(state)
            motor.position = motor.position - 0.1 * (state.joint_position - motor.position)
            return motor

    runs = []
    for _ in range(2):
        start(instance, seed=7, real_time_factor=1.0)
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
    assert len(runs[0]) == 501 and runs[0] == runs[1]


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
    assert upright(later) and np.abs(later.joint_position - held.joint_position).max() < 0.05
    assert client.hear().motor_sequence == sent
    assert "held" in instance.log("comms_manager")
    wait_until(lambda: watch.statistics().detail == f"{MOTOR.name}: silent", 30, "who is silent is named")
    # A Motion Manager that starts anew counts from one.
    fresh = ServoClient(node, ROBOT)
    fresh.answer_until(lambda s: s.time > later.time + 2e9 and not watch.clock().holding)
    assert fresh.hear().time > state.time


def not_finite(motor: Motor) -> None:
    motor.effort[5] = np.nan


def of_an_older_motion_manager(motor: Motor) -> None:
    motor.writer = 1


def test_unsound_motors_are_rejected_completely_and_move_nothing(instance: RunningInstance) -> None:
    start(instance, actuators="ideal")
    node = instance.node()
    watch, client = Watch(node), ServoClient(node, ROBOT)
    state = client.run_to(0.5)
    before = watch.statistics().rejected
    for spoil in (not_finite, of_an_older_motion_manager):
        bad = client.command(state)
        bad.mode = np.full(38, JointMode.FORCE, dtype=np.uint8)
        bad.effort = np.full(38, 100.0)  # it would throw the robot over
        spoil(bad)
        client.publish(bad)
        good = client.command(state)
        client.publish(good)
        after = client.answer_until(lambda s, sent=good.sequence: s.motor_sequence >= sent)  # type: ignore[misc]
        assert np.abs(after.joint_effort).max() < 150, spoil.__name__
        client.publish(client.command(after))  # the world waits for an answer to each of its states
        state = client.run_to(after.time * 1e-9 + 0.05)
    client.publish(client.command(state))
    client.answer_until(lambda _: watch.statistics().rejected - before == 2)
    assert upright(watch.truth())
    assert instance.log("comms_manager").count(" rejected: ") == 2


def test_a_push_moves_the_robot_and_bad_ones_are_refused(instance: RunningInstance) -> None:
    start(instance)
    node = instance.node()
    watch, push = Watch(node), Pusher(node)
    with client_process(instance):
        before = watch.truth_at(5.0)
        for impulse, duration, reason in (
            ((np.nan, 0, 0), 0.1, "impulse_in_world"),
            ((0, 501, 0), 0.1, "at most 500"),
            ((1, 0, 0), 2.1, "up to 2"),
        ):
            reply = push(*impulse, duration=duration)
            assert not reply.accepted and reason in reply.reason
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
        assert upright(back) and abs(back.com_in_world[1] - quiet.com_in_world[1]) < 0.003


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


def test_a_bad_setting_ends_it_with_one_line(instance: RunningInstance) -> None:
    instance.configure(world="moon")
    process = instance.start("comms_manager")
    assert process.wait(30) == EXIT_CONFIGURATION
    (line,) = instance.log("comms_manager").strip().splitlines()
    assert "world 'moon': expected one of flat" in line


def test_stops_when_requested_while_standing_by_waiting_and_running(instance: RunningInstance) -> None:
    start(instance)
    assert instance.stop("comms_manager") == 0
    start(instance)
    client = ServoClient(instance.node(), ROBOT)
    client.run_to(0.2)
    assert instance.stop("comms_manager") == 0 and "Traceback" not in instance.log("comms_manager")


def test_time_is_paused_stepped_slowed_down_and_a_stop_lets_it_pass(instance: RunningInstance) -> None:
    start(instance)
    node = instance.node()
    watch, client, stop = Watch(node), SIMULATED_TIME.client(node), STOP.client(node)

    def ask(wanted: str, value: float = 0.0) -> messages.TimeReply:
        return client.call(messages.TimeRequest(wanted, value), timeout=10.0)

    assert "has not started" in ask("pause").reason
    with client_process(instance):
        watch.truth_at(0.2)
        paused = ask("pause")
        assert paused.accepted and paused.paused
        wait_until(lambda: watch.clock().mode == PAUSED, 10, "it says so")
        assert ask("").time == paused.time
        assert "paused" in watch.statistics().detail
        period = round(ROBOT.control_period * 1e9)
        for count in (1, 7):
            before = ask("").time
            assert ask("step", count).accepted
            wait_until(lambda: ask("").paused, 10, "the steps are done")
            assert ask("").time == before + count * period
        for wanted, value in (
            ("step", 0),
            ("step", 1.5),
            ("step", np.nan),
            ("factor", -1),
            ("factor", np.nan),
            ("x", 0),
        ):
            refused = ask(wanted, value)
            assert not refused.accepted
            assert refused.paused and refused.reason.startswith("wanted" if wanted == "x" else wanted)
        assert ask("factor", 0.1).accepted
        began, clock = ask("resume").time, time.monotonic()
        watch.truth_at(began * 1e-9 + 0.1)
        assert time.monotonic() - clock > 0.5, "a tenth of the wall's time"
        assert ask("pause").paused
        stop.call(BehaviorRequest(Behavior.FREEZE), timeout=10.0)
        assert not ask("").paused


def test_any_body_of_the_robot_is_pushed_and_none_of_the_world(instance: RunningInstance) -> None:
    start(instance)
    node = instance.node()
    watch, pusher = Watch(node), PUSH.client(node)
    with client_process(instance):
        before = watch.truth_at(2.0)
        for body in ("world", "floor", "nobody"):
            refused = pusher.call(PushRequest(np.array((1.0, 0.0, 0.0)), 0.1, body), timeout=10.0)
            assert refused.reason.startswith(f"body: '{body}'")
        elbow, hand = ROBOT.index["l_elbow_pitch"], "l_hand"
        assert pusher.call(PushRequest(np.array((0.0, 0.0, 3.0)), 0.1, hand), timeout=10.0).accepted
        wait_until(
            lambda: abs(watch.truth().joint_position[elbow] - before.joint_position[elbow]) > 0.01,
            30,
            "the arm gives way",
        )
