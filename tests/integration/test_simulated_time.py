"""What a simulation grants beside physics: its time paused, stepped and slowed down, and pushes at any body."""

from __future__ import annotations

import time

import numpy as np

from harness.comms_manager_alone import Watch, client_process, start
from harness.instance import RunningInstance
from harness.places import REPOSITORY
from harness.waiting import wait_until
from valor.common.behaviors import Behavior
from valor.common.messages import BehaviorRequest, PushRequest, TimeReply, TimeRequest
from valor.common.topics import PAUSED, PUSH, SIMULATED_TIME, STOP
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(REPOSITORY / "robots" / "escher")


def test_time_is_paused_stepped_slowed_down_and_a_stop_lets_it_pass(instance: RunningInstance) -> None:
    start(instance)
    node = instance.node()
    watch, client, stop = Watch(node), SIMULATED_TIME.client(node), STOP.client(node)

    def ask(wanted: str, value: float = 0.0) -> TimeReply:
        return client.call(TimeRequest(wanted, value), timeout=10.0)

    assert "not begun" in ask("pause").reason
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
