"""Streams of trajectories, each replacing the one before: the arm follows them, at any rate, and never runs away."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bifrost import Received
from harness.closed_loop import load_robot
from harness.examples import examples
from harness.streamed_robot import StreamedRobot
from tests.unit.test_vrc_joint_trajectory_controller import NAMES, Arm
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior, Manipulation
from valor.common.messages import JointSetpoints
from valor.motion_manager.handlers.joint_setpoints import JointSetpointsHandler
from valor.motion_manager.joints.upper_body import LOST
from valor.valor_ros_controller.controllers.trajectory_goal import TrajectoryOutcome, TrajectoryRequest
from valor.valor_ros_controller.trajectory.admission import check_waypoints
from valor.valor_ros_controller.trajectory.waypoints import Point
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

CYCLE = 0.004  # of the VRC [s]
AHEAD = 0.15  # time from a message to its point [s]
FOLLOWED = 0.05  # [rad]


@pytest.fixture(scope="module")
def robot() -> StreamedRobot:
    return StreamedRobot(load_robot())


@pytest.mark.parametrize("rate", [10, 100, 250, 1000])
def test_a_stream_of_one_goal_ends_there_and_stays(robot: StreamedRobot, rate: float) -> None:
    """The measured arm; the acceleration that is fed forward belongs to motion that is commanded."""
    start = robot.arm
    for sign in (1.0, -1.0):
        goal = robot.controller.position + sign * 0.1
        due = 0.0
        for cycle in range(round(1.5 / CYCLE)):
            while due <= cycle * CYCLE:
                robot.submit([Point(list(goal), [0.0] * len(goal), [], [], AHEAD)])
                due += 1.0 / rate
            robot.cycle()
            between = np.minimum(start, goal) - FOLLOWED, np.maximum(start, goal) + FOLLOWED
            assert (robot.arm > between[0]).all() and (robot.arm < between[1]).all(), robot.arm - goal
        assert np.abs(robot.arm - goal).max() < 0.01
        start = robot.arm
    assert robot.controller.rejections.count == 0


@examples(12)
@given(
    rate=st.floats(1.0, 1000.0), order=st.sampled_from([1, 3, 5]), amplitude=st.floats(-0.2, 0.2),
    period=st.floats(1.5, 4.0), jitter=st.floats(0.0, 0.9), lost=st.floats(0.0, 0.3), seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_any_stream_is_followed_and_velocity_is_what_the_position_does(
    rate: float, order: int, amplitude: float, period: float, jitter: float, lost: float, seed: int
) -> None:
    arm, random = Arm().start(), np.random.default_rng(seed)
    controller = arm.controller
    home, turn = controller.position.copy(), 2.0 * pi / period
    ahead = max(AHEAD, 1.5 / rate)  # a point is not reached before the next one comes

    def wanted(time: float) -> tuple[float, float, float]:
        angle = turn * time
        return amplitude * (1 - cos(angle)) / 2, amplitude * turn * sin(angle) / 2, amplitude * turn**2 * cos(angle) / 2

    due, before, worst = 0.0, np.array(controller._state), 0.0
    for cycle in range(round(2.0 / CYCLE)):
        now = cycle * CYCLE
        while due <= now:
            position, velocity, acceleration = wanted(due + ahead)
            velocities = [velocity] * len(NAMES) if order > 1 else []
            accelerations = [acceleration] * len(NAMES) if order == 5 else []
            if random.random() >= lost:
                point = Point(list(home + position), velocities, accelerations, [], ahead)
                waypoints = check_waypoints(NAMES, [point], controller.limits, at_rest=False)
                settings = controller.settings
                controller.submit(TrajectoryRequest(waypoints, 0, settings.path, settings.goal, 2.0, None))
            due += (1.0 + jitter * random.uniform(-1.0, 1.0)) / rate
        arm.run(CYCLE)
        p, v, a = controller._state
        highest = max(np.abs(a).max(), np.abs(before[2]).max())
        if order > 1:  # velocity has no steps
            assert (np.abs(p - before[0] - v * CYCLE) <= highest * CYCLE**2 + 1e-9).all(), "position does not go on"
        before = np.array(controller._state)
        if rate > 20.0 and order > 1:
            worst = max(worst, float(np.abs(p - home - wanted(now)[0]).max()))
    assert worst < FOLLOWED
    arm.assert_no_jump()


def test_a_canceled_motion_goes_on_without_a_step_back() -> None:
    arm = Arm().start()
    controller = arm.controller
    arm.request([Point(list(controller.position + 0.5), [], [], [], 1.0)])
    arm.run(0.5)
    velocity = controller.velocity.copy()
    before = controller.position.copy()
    controller._come_to_rest(arm.hw)
    arm.run(CYCLE)
    assert ((controller.position - before) / velocity > 0.9 * CYCLE).all()


class Waiting:
    def finish(self, outcome: TrajectoryOutcome) -> None:
        pass

    def feedback(self, hw: ValorEscherHWInterface) -> None:
        pass


@pytest.mark.parametrize("profile", ["hardware", "hdt_arms"])
def test_a_motor_command_has_no_steps_when_a_motion_is_canceled_or_its_sender_dies(profile: str) -> None:
    """Whatever compensates the servos' friction and play, too."""
    robot = StreamedRobot(load_robot(), profile)
    controller, parts, client = robot.controller, robot.manager.components, Waiting()
    joints, fastest = controller.joints, robot.robot.velocity_limit[controller.joints]
    positions: list[FloatArray] = []
    robot.each = lambda: positions.append(parts.command.position[joints])
    for sign, canceled in ((1.0, True), (-1.0, True), (1.0, False)):
        goal = np.clip(controller.position + sign * 0.8, controller.limits.lower, controller.limits.upper)
        robot.submit([Point(list(goal), [], [], [], 1.0)], client)
        for _ in range(round(0.4 / CYCLE)):
            robot.cycle()
        farthest = before = parts.reference.position[joints]
        if canceled:
            controller.cancel(client)
        for _ in range(round(0.4 / CYCLE)):
            robot.cycle() if canceled else robot.run(CYCLE)
            farthest = np.maximum(sign * farthest, sign * parts.reference.position[joints]) * sign
        assert (sign * (farthest - before) > 0.01).all()
        np.testing.assert_allclose(parts.reference.position[joints], farthest, atol=1e-3)  # no way back
        assert np.abs(parts.reference.velocity[joints]).max() < 1e-3
    steps = np.abs(np.diff(positions, axis=0)) / robot.robot.control_period
    assert (steps <= 1.001 * fastest).all(), steps.max(axis=0)


def test_an_acceleration_without_motion_moves_no_arm(robot: StreamedRobot) -> None:
    """As any sender's: position and velocity say rest, the acceleration does not."""
    parts, names = robot.manager.components, list(robot.names)
    handler, before, start = JointSetpointsHandler(parts), parts.rejections.total, robot.arm
    position = parts.reference.position[robot.controller.joints]
    for _ in range(250):
        setpoint = JointSetpoints(robot.manager.time, names, position, np.zeros(7), np.full(7, 20.0))
        assert handler.handle(Received(setpoint, 0, 1, "test"), robot.manager.time)
        robot.step()
        robot.step()
        assert np.abs(robot.arm - start).max() < FOLLOWED
    assert parts.rejections.total > before and "not fed forward" in parts.rejections.take()[-1].reason


def test_an_arm_that_leaves_its_command_holds_until_the_mode_changes(robot: StreamedRobot) -> None:
    parts, side = robot.manager.components, 0
    body = robot._bodies[side]
    for _ in range(500):
        robot.submit([Point(list(robot.controller.position), [], [], [], AHEAD)])
        robot.plant.data.xfrc_applied[body, 2] = 250.0  # upward [N]
        robot.cycle()
        if parts.upper_body.closed(Manipulation):
            break
    robot.plant.data.xfrc_applied[body] = 0.0
    assert "away from its command" in parts.upper_body.closed(Manipulation)
    np.testing.assert_allclose(parts.reference.position[robot.controller.joints], robot.arm, atol=0.1)
    held = parts.reference.position[robot.controller.joints]
    handler = JointSetpointsHandler(parts)
    setpoint = JointSetpoints(robot.manager.time, list(robot.names), *np.zeros((3, 7)))
    assert not handler.handle(Received(setpoint, 0, 1, "test"), robot.manager.time)
    robot.run(1.0)
    np.testing.assert_allclose(parts.reference.position[robot.controller.joints], held, atol=0.06)  # within the limits
    assert not robot.ask(Behavior.STAND)
    robot.run(0.5)
    assert not robot.ask(Behavior.STAND_MANIPULATE)
    robot.run(0.5)
    assert not parts.upper_body.closed(Manipulation)


def test_a_blocked_arm_keeps_its_command(robot: StreamedRobot) -> None:
    """A hand at a fixture that is shut."""
    parts, mj = robot.manager.components, robot.plant.model.mj
    joints, armature = robot.controller.joints, mj.dof_armature.copy()
    start = robot.controller.position
    goal = np.where(start + 0.6 < parts.robot.upper[joints], start + 0.6, start - 0.6)
    mj.dof_armature[np.arange(mj.nv)[robot.plant.model.dof][joints]] = 1e4
    handler, still = JointSetpointsHandler(parts), np.zeros(7)
    try:
        for share in np.minimum(1.0, np.arange(0.0, 1.5, CYCLE)):
            point = start + share * (goal - start)
            setpoint = JointSetpoints(robot.manager.time, list(robot.names), point, still, still)
            assert handler.handle(Received(setpoint, 0, 1, "test"), robot.manager.time)
            robot.step()
            robot.step()
        assert np.abs(parts.reference.position[joints] - robot.arm).max() > LOST
        assert not parts.upper_body.closed(Manipulation)
    finally:
        mj.dof_armature[:] = armature
