"""What the Valor ROS Controller accepts, the Motion Manager's limiter follows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.places import ROBOTS
from harness.vrc_in_process import PERIOD, System
from valor.common.arrays import FloatArray
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.limiter import Limiter
from valor.valor_ros_controller.controllers.configuration import Settings, TrajectoryControllerConfig
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.controllers.table import ControllersTable
from valor.valor_ros_controller.controllers.trajectory_goal import TrajectoryOutcome, TrajectoryRequest
from valor.valor_ros_controller.trajectory.admission import begin, check_waypoints
from valor.valor_ros_controller.trajectory.execution import Trajectory
from valor.valor_ros_controller.trajectory.waypoints import ErrorCode, InvalidTrajectoryError, Point
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

ARM = "right_arm_traj_controller"
INTERFACES = {name: ValorEscherHWInterface(RobotDescription.load(ROBOTS / name)) for name in ("escher", "thor")}
CONFIGS = ControllersTable.load().of_type(TrajectoryControllerConfig)
CONTROLLERS = [
    (robot, name) for robot in INTERFACES for name in CONFIGS
    if not name.startswith("right") and (robot, name) != ("thor", "left_hand_traj_controller")
]  # fmt: skip


class Client:
    outcome: TrajectoryOutcome | None = None

    def finish(self, outcome: TrajectoryOutcome) -> None:
        self.outcome = outcome

    def feedback(self, hw: object) -> None: ...


def lead(controller: JointTrajectoryController, joint: int, speed: float, seconds: float) -> Client:
    """Ask for one joint at a speed, from the running system's posture."""
    goal = controller.position.copy()
    goal[joint] += speed * seconds
    client, settings = Client(), controller.settings
    waypoints = check_waypoints(controller.limits.names, [Point(goal.tolist(), [], [], [], seconds)], controller.limits)
    controller.submit(TrajectoryRequest(waypoints, 0, settings.path, settings.goal, settings.goal_time, client))
    return client


@pytest.fixture
def manipulating() -> System:
    system = System()
    system.run(4)
    for mode in ("stand", "stand_manipulate", "manipulate"):
        system.ask(mode)
        system.run(30)
    return system


def test_a_goal_just_below_the_speed_limit_is_reached(manipulating: System) -> None:
    controller = manipulating.vrc.trajectories[ARM]
    joint = controller.limits.names.index("r_shoulder_pitch")
    client = lead(controller, joint, -0.98 * controller.limits.velocity[joint], 1.1)
    manipulating.run(round(3e9 / PERIOD), until=lambda: client.outcome is not None)
    assert client.outcome is not None
    assert client.outcome.code is ErrorCode.SUCCESSFUL, client.outcome.text


def test_what_a_joint_can_do_and_may_not_be_commanded_is_refused_before_it_moves(manipulating: System) -> None:
    controller, robot = manipulating.vrc.trajectories[ARM], manipulating.vrc.hw.robot
    joint = controller.limits.names.index("r_shoulder_pitch")
    client = lead(controller, joint, -0.98 * robot.tables.joints["r_shoulder_pitch"].velocity, 1.1)
    before = controller.position.copy()
    manipulating.run(4)
    assert client.outcome is not None and client.outcome.code is ErrorCode.INVALID_GOAL
    assert "r_shoulder_pitch would move at 2.04 rad/s" in client.outcome.text
    assert f"its limit is {controller.limits.velocity[joint]:g} rad/s" in client.outcome.text
    assert np.array_equal(controller.position, before)


class Follower:
    """The Motion Manager's limiter behind one controller's joints."""

    def __init__(self, limits: CommandedLimits, start: FloatArray) -> None:
        self._limiter = Limiter(limits)
        self._limiter.reset(np.ones(len(start), dtype=bool), start)

    def worst_error(self, trajectory: Trajectory, start: int, period: int) -> FloatArray:
        """(n,) How far behind, or ahead of, a trajectory it ever is."""
        state = np.zeros((3, len(self._limiter.position)))
        position, velocity, _ = state
        worst = np.zeros_like(position)
        for time in range(start + period, trajectory.end + 10 * period, period):
            trajectory.sample(time, state)
            self._limiter.advance(position, velocity, period * 1e-9)
            worst = np.maximum(worst, np.abs(self._limiter.position - position))
        return worst


@st.composite
def journeys(draw: st.DrawFn, limits: CommandedLimits) -> tuple[FloatArray, list[Point]]:
    """A start and way-points within the limits, about as fast as may be, of any mixture of what points may carry."""
    lower, upper = np.maximum(limits.lower, -3.0), np.minimum(limits.upper, 3.0)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    hurry = draw(st.floats(0.3, 1.05))
    carried = draw(st.sampled_from([(1,), (3,), (5,), (1, 3, 5)]))
    reach = draw(st.sampled_from([0.02, 0.1, 0.4, 1.0]))  # of the way between two limits
    start = here = rng.uniform(lower, upper)
    points: list[Point] = []
    time, count = 0.0, draw(st.integers(1, 12))
    for i in range(count):
        there = np.clip(here + reach * rng.uniform(-1, 1, len(here)) * (upper - lower), lower, upper)
        order = draw(st.sampled_from(carried))
        peak = {1: 1.0, 3: 1.5, 5: 1.875}[order]
        time += max(0.004, peak * float((np.abs(there - here) / limits.velocity).max()) / hurry)
        moving = rng.uniform(-0.3, 0.3, len(here)) * limits.velocity * (i < count - 1) * draw(st.booleans())
        velocity, acceleration = list(moving) if order > 1 else [], list(0.0 * moving) if order > 3 else []
        points.append(Point(list(there), velocity, acceleration, [], time))
        here = there
    return start, points


@pytest.mark.parametrize(("robot", "name"), CONTROLLERS)
@examples(15)
@given(st.data())
def test_what_is_accepted_is_followed_to_within_the_path_tolerance(robot: str, name: str, data: st.DataObject) -> None:
    hw, config = INTERFACES[robot], CONFIGS[name]
    limits = hw.limits(hw.group_indices(config.groups))
    start, points = data.draw(journeys(limits))
    tolerance = Settings.of(config.parameters(limits.names), limits.names).path.position
    still, now = np.zeros_like(start), 1_000_000_000
    try:
        waypoints = check_waypoints(limits.names, points, limits)
        trajectory = begin(waypoints, 0, now, np.array((start, still, still)), limits, since=now, error=tolerance)
    except InvalidTrajectoryError:
        return
    worst = Follower(limits, start).worst_error(trajectory, now, round(1e9 * hw.robot.control_period))
    assert (worst <= tolerance).all(), (worst, tolerance)


@pytest.mark.parametrize(("robot", "name"), CONTROLLERS)
def test_to_and_fro_at_the_greatest_speed_is_followed_to_within_the_path_tolerance(robot: str, name: str) -> None:
    """The worst that may be: velocity turns round whenever the limiter is about to have caught up."""
    hw, config = INTERFACES[robot], CONFIGS[name]
    everything = hw.limits(hw.group_indices(config.groups))
    tolerance = Settings.of(config.parameters(everything.names), everything.names).path.position
    period = hw.robot.control_period
    limits = CommandedLimits(
        everything.names, everything.units, np.full(len(tolerance), -np.inf), np.full(len(tolerance), np.inf),
        everything.velocity, everything.acceleration, everything.effort,
    )  # fmt: skip
    speed = limits.jumping_velocity(tolerance)
    for share in np.linspace(1.0, 10.0, 10):  # of the time to turn round in
        for pause in (0, 1):
            limiter, target = Limiter(limits), np.zeros(len(tolerance))
            limiter.reset(np.ones(len(tolerance), dtype=bool), target)
            turning = share * 2.0 * speed / limits.acceleration
            worst = np.zeros(len(tolerance))
            for step in range(600):
                sign = np.where(np.floor(step * period / turning) % 2 == 0, 1.0, -1.0 + pause)
                target = target + sign * speed * period
                limiter.advance(target, sign * speed, period)
                worst = np.maximum(worst, np.abs(limiter.position - target))
            assert (worst <= tolerance).all(), (share, worst, tolerance)
