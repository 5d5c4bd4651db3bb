"""What recurs and what streams: by its schedule, followed, and never a line of the log for each."""

from __future__ import annotations

import logging
from itertools import pairwise
from math import cos, pi, sin

import numpy as np
import pytest

from tests.unit.test_vrc_joint_trajectory_controller import NAMES, ROBOT, Arm, Client, point, target
from valor.valor_ros_controller.controllers.joint_trajectory_controller import Schedule
from valor.valor_ros_controller.controllers.trajectory_goal import CATCH_UP, TrajectoryRequest
from valor.valor_ros_controller.rejection_log import LINES, PERIOD, BoundedLog, RejectionLog
from valor.valor_ros_controller.trajectory.admission import check_waypoints
from valor.valor_ros_controller.trajectory.waypoints import ErrorCode, InvalidTrajectoryError, Point

CYCLE = 4_000_000  # [ns]
AMPLITUDE, RATE = 0.2, 2 * pi / 2.0  # of every joint [rad], [rad/s]


class Stream:
    """Sends the next point of a sine to an arm, as Servo does."""

    def __init__(self, arm: Arm, *, velocities: bool, ahead: float) -> None:
        self.arm, self.velocities, self.ahead = arm, velocities, ahead
        self.time = 0.0

    def send(self) -> None:
        t = self.time + self.ahead
        place, velocity = AMPLITUDE * (1 - cos(RATE * t)) / 2, AMPLITUDE * RATE * sin(RATE * t) / 2
        speeds = [velocity] * len(NAMES) if self.velocities else []
        self.submit([Point(target(place), speeds, [], [], self.ahead)])

    def submit(self, points: list[Point]) -> None:
        c = self.arm.controller
        waypoints = check_waypoints(NAMES, points, c.limits, at_rest=False)
        c.submit(TrajectoryRequest(waypoints, 0, c.settings.path, c.settings.goal, 2.0, None))


@pytest.mark.parametrize("velocities", [False, True])
@pytest.mark.parametrize("jitter", [0, 3])
def test_a_hundred_points_a_second_are_tracked(velocities: bool, jitter: int, caplog: pytest.LogCaptureFixture) -> None:
    """Messages come up to three cycles early or late."""
    arm = Arm().start()
    stream = Stream(arm, velocities=velocities, ahead=0.02)
    random = np.random.default_rng(1)
    worst, due = 0.0, 0.0
    for cycle in range(1000):
        stream.time = cycle * CYCLE * 1e-9
        if stream.time >= due:
            due += 0.01
            if not jitter or random.random() < 0.8:  # a message that is lost
                stream.send()
        arm.run(CYCLE * 1e-9)
        wanted = np.array(target(AMPLITUDE * (1 - cos(RATE * stream.time)) / 2))
        worst = max(worst, float(np.abs(arm.arm - wanted).max()))
    assert worst < 0.05, "the arm does not follow"
    arm.assert_no_jump()
    assert arm.controller.rejections.count == 0, arm.controller.rejections.last
    assert not caplog.records


def test_what_ends_in_motion_decelerates_to_rest_within_the_limits() -> None:
    arm = Arm().start()
    stream = Stream(arm, velocities=True, ahead=0.5)
    stream.submit([Point(target(0.1), [0.4] * len(NAMES), [], [], 0.5)])
    arm.run(0.51)
    assert np.abs(arm.controller.velocity).max() > 0.3, "it stops at once"
    arm.run(0.5)
    assert np.abs(arm.controller.velocity).max() == 0.0
    assert (arm.arm > np.array(target(0.1))).all()
    arm.assert_no_jump()
    with pytest.raises(InvalidTrajectoryError, match="at the last point; expected 0"):
        check_waypoints(NAMES, [Point(target(0.1), [0.4] * len(NAMES), [], [], 0.5)], arm.controller.limits)


def test_a_stream_may_fall_behind_a_little_and_a_point_far_away_is_refused() -> None:
    arm = Arm().start()
    stream = Stream(arm, velocities=False, ahead=0.02)
    near = 0.5 * CATCH_UP * float(ROBOT.velocity_limit[arm.controller.joints].min()) * 0.8
    stream.submit([point(0.01, near)])
    arm.run(0.3)
    assert arm.arm == pytest.approx(target(near), abs=1e-6)
    arm.assert_no_jump()
    stream.submit([point(0.01, -0.6)])
    arm.run(0.1)
    assert "would move at" in arm.controller.rejections.drain()[-1][0]
    assert arm.arm == pytest.approx(target(near), abs=1e-6), "it moves all the same"
    client = Client()
    arm.request([point(0.01, 0.0)], client)
    arm.run(0.1)
    assert client.outcome.code is ErrorCode.INVALID_GOAL, "a goal is as late as it was asked to be"


def test_a_schedule_keeps_its_rate_whatever_the_cycle() -> None:
    for rate in (1.0, 19.0, 20.0, 33.0, 100.0, 250.0):
        schedule, period = Schedule(), round(1e9 / rate)
        schedule.begin(CYCLE)
        due = [time for time in range(CYCLE, 20_000_000_000, CYCLE) if schedule.due(time, period)]
        assert len(due) == pytest.approx(20.0 * rate, abs=1.5)
        assert max(b - a for a, b in pairwise(due)) <= period + CYCLE
    assert schedule.due(0, period), "time has gone back"
    assert not schedule.due(1, period)
    assert schedule.due(10**12, period) and not schedule.due(10**12 + CYCLE // 2, period), "it makes up for lost time"


def test_the_log_has_some_lines_at_once_and_then_one_now_and_then(caplog: pytest.LogCaptureFixture) -> None:
    now = 0.0
    refusals = RejectionLog(BoundedLog(logging.getLogger("streams"), clock=lambda: now), "{}")
    for i in range(6000):  # a minute at 100 Hz, each with another reason
        now = i * 0.01
        refusals.add("arm", f"reason {i}")
    assert refusals.count == 6000 and refusals.last == "arm: reason 5999"
    assert LINES <= len(caplog.records) <= LINES + 60.0 / PERIOD
    assert "more omitted" in caplog.records[-1].getMessage()
    assert 0 < len(refusals.drain()) <= 10 and not refusals.drain()
