"""What only the Motion System has, led from outside: hand goals, joint gains, balance weights."""

import numpy as np
import pytest

from bifrost import Received
from harness.still_robot import ROBOT, Robot
from valor.common.behaviors import Behavior
from valor.common.messages import BalanceWeights, HandGoal, HandGoalStatus, JointGains, JointSetpoints
from valor.control.tuning_tables import Tuning
from valor.motion_manager.handlers.joint_setpoints import JointSetpointsHandler
from valor.motion_manager.handlers.motion import HandGoalHandler
from valor.motion_manager.handlers.tuning import BalanceWeightsHandler, JointGainsHandler
from valor.motion_manager.hands.hand_goals import GRACE

RIGHT = ROBOT.group_indices("right_arm")
LEFT = ROBOT.group_indices("left_arm")
NOBODY = np.array((1.0, 0.0, 0.0, 0.0))


@pytest.fixture
def robot() -> Robot:
    return standing()


@pytest.fixture(scope="module")
def refusing() -> Robot:
    """The same, for what changes nothing."""
    return standing()


def standing() -> Robot:
    robot = Robot()
    robot.run(1.0)
    for behavior in (Behavior.STAND, Behavior.STAND_MANIPULATE):
        assert not robot.ask(behavior)
        robot.run(0.5)
    return robot


def goal(robot: Robot, position: object, **changes: object) -> HandGoal:
    values: dict[str, object] = {
        "time": robot.time, "hand": 1, "active": True, "frame": "pelvis", "position": position,
        "orientation": NOBODY,
    }  # fmt: skip
    return HandGoal(**(values | changes))  # type: ignore[arg-type]


def lead(robot: Robot, message: HandGoal, origin: str = "somebody") -> bool:
    return HandGoalHandler(robot.manager.components).handle(Received(message, 0, 1, origin), robot.time)


def follow(robot: Robot, *, but: int | None = None) -> None:
    """A period, after which every joint is where Motor wants it; but one stays."""
    assert robot.motor is not None
    position = robot.motor.position.copy()
    if but is not None:
        position[but] = ROBOT.nominal_posture[but]
    robot.tick(joint_position=position)


def refusal(robot: Robot) -> str:
    """Why the last one was rejected; the next is reported, too, however little of the wall's time passes until then."""
    rejections = robot.manager.rejections
    reason = rejections.take()[-1].reason
    rejections._published.clear()
    return reason


def test_a_hand_goes_to_its_goal_and_reports_it(robot: Robot) -> None:
    """Level, 0.4 m before the pelvis and 0.2 m above it; the other arm stays; no joint is too fast."""
    manager = robot.manager
    before = manager.components.reference.position.copy()
    assert lead(robot, goal(robot, np.array((0.4, -0.3, 0.2))))
    assert manager.report(0.0).right_arm == "hand_goal" and manager.report(0.0).left_arm == "setpoints"
    set_points = []
    for _ in range(round(6.0 / ROBOT.control_period)):
        follow(robot)
        set_points.append(manager.components.reference.position.copy())
        if manager.components.hand_goals.status(1, 0).state == "reached":
            break
    status = manager.components.hand_goals.status(1, robot.time)
    assert status.state == "reached", status
    assert status.position_error < 0.005
    rates = np.abs(np.diff(set_points, axis=0)) / ROBOT.control_period
    assert (rates <= 0.81 * ROBOT.velocity_limit).all()
    np.testing.assert_allclose(set_points[-1][LEFT], before[LEFT], atol=1e-9)


def test_a_goal_out_of_reach_is_approached_and_stated(robot: Robot) -> None:
    assert lead(robot, goal(robot, np.array((2.0, -0.3, 0.2))))
    for _ in range(round(12.0 / ROBOT.control_period)):
        follow(robot)
        if robot.manager.components.hand_goals.status(1, 0).state == "out_of_reach":
            break
    status = robot.manager.components.hand_goals.status(1, 0)
    assert status.state == "out_of_reach" and status.position_error > 0.5
    assert "the right hand gets no nearer" in status.reason


def led_with_a_jammed_wrist(robot: Robot, yaw: float) -> tuple[HandGoalStatus, float]:
    """How a hand ends that is to be turned about z [rad], and the largest difference of the wrist's angle [rad]."""
    turned = np.array((np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)))
    assert lead(robot, goal(robot, np.array((0.4, -0.3, 0.2)), orientation=turned))
    wrist, goals = ROBOT.index["r_wrist_yaw"], robot.manager.components.hand_goals
    for _ in range(round(20.0 / ROBOT.control_period)):
        follow(robot, but=wrist)
        if goals.status(1, 0).state != "moving":
            break
    return goals.status(1, 0), abs(robot.manager.components.reference.position[wrist] - ROBOT.nominal_posture[wrist])


def test_what_a_joint_that_does_not_turn_leaves_is_reported_with_its_name(robot: Robot) -> None:
    status, _ = led_with_a_jammed_wrist(robot, 1.5)
    assert status.state == "out_of_reach", status
    assert "does not follow: r_wrist_yaw" in status.reason
    assert f"{status.position_error:.3f} m and {status.orientation_error:.3f} rad remain" in status.reason
    assert status.position_error > 0.005 or status.orientation_error > 0.02


def test_the_other_joints_make_up_for_one_that_does_not_turn(robot: Robot) -> None:
    status, off = led_with_a_jammed_wrist(robot, 0.5)
    assert status.state == "reached", status
    assert off < 0.06


def test_the_arm_has_one_leader(robot: Robot) -> None:
    """Set-points are refused while the goal moves the arm; leaving the manipulate behavior ends the goal."""
    manager = robot.manager

    def send() -> bool:
        names = [ROBOT.joints[i] for i in RIGHT]
        zeros = np.zeros(len(names))
        message = JointSetpoints(robot.time, names, manager.components.reference.position[RIGHT], zeros, zeros)
        return JointSetpointsHandler(manager.components).handle(Received(message, 0, 1, "somebody"), robot.time)

    assert send()
    assert lead(robot, goal(robot, np.array((0.4, -0.3, 0.2))))
    assert send(), "the sender cannot know yet"
    robot.run(GRACE + 0.01)
    assert not send()
    assert "the right arm follows a hand goal" in refusal(robot) and not robot.ask(Behavior.STAND)
    robot.run(0.1)
    assert not manager.components.hand_goals.active
    assert manager.components.hand_goals.status(1, 0).reason == "the behavior is stand"


def test_gains_go_gradually_to_what_is_asked_within_the_limits(robot: Robot) -> None:
    name = "r_elbow_pitch"
    place, table = ROBOT.index[name], ROBOT.read(Tuning).gains
    nominal = ROBOT.servo_stiffness[place]
    message = JointGains([name], np.array((1e6,)), np.array((0.0,)))
    assert JointGainsHandler(robot.manager.components).handle(Received(message, 0, 1, "somebody"), robot.time)
    stiffness = [nominal] + [robot.tick().stiffness[place] for _ in range(400)]
    assert np.abs(np.diff(stiffness)).max() < 0.01 * nominal
    assert stiffness[-1] == pytest.approx(table.max_stiffness * nominal)
    assert robot.tick().damping[place] == pytest.approx(table.min_damping * ROBOT.servo_damping[place])
    np.testing.assert_array_equal(robot.tick().stiffness[LEFT], ROBOT.servo_stiffness[LEFT])


@pytest.mark.parametrize(
    ("names", "stiffness", "reason"),
    [
        (["l_knee_pitch"], (1.0,), "'l_knee_pitch' is not driven by impedance"),
        (["nose"], (1.0,), "unknown joint 'nose'"),
        (["r_elbow_pitch", "r_elbow_pitch"], (1.0, 1.0), "named twice"),
        (["r_elbow_pitch"], (float("nan"),), "expected a finite number"),
        (["r_elbow_pitch"], (1.0, 1.0), "2 numbers for 1 names"),
    ],
)
def test_bad_gains_are_refused(refusing: Robot, names: list[str], stiffness: tuple[float, ...], reason: str) -> None:
    message = JointGains(names, np.array(stiffness), np.ones(len(names)))
    assert not JointGainsHandler(refusing.manager.components).handle(
        Received(message, 0, 1, reason), 0
    )  # told once an origin
    assert reason in refusal(refusing)


def test_weights_go_gradually_and_end_with_the_balance(robot: Robot) -> None:
    weights, handler = robot.manager.components.whole_body.weights, BalanceWeightsHandler(robot.manager.components)
    assert handler.handle(Received(BalanceWeights(["com"], np.array((1e9,))), 0, 1, "somebody"), robot.time)
    robot.tick()
    assert weights.nominal[0] < weights.values[0] < 1.1 * weights.nominal[0]
    robot.run(1.0)
    assert weights.values[0] == pytest.approx(ROBOT.tables.weight_factor * weights.nominal[0])
    assert not handler.handle(Received(BalanceWeights(["luck"], np.ones(1)), 0, 1, "somebody"), robot.time)
    assert "unknown task 'luck'; expected com, angular_momentum" in refusal(robot)
    for behavior in (Behavior.STAND, Behavior.STAND_PREP):
        assert not robot.ask(behavior)
        robot.run(1.5)
    assert not handler.handle(Received(BalanceWeights(["com"], np.ones(1)), 0, 1, "somebody"), robot.time)
    assert "accepted while the robot balances" in refusal(robot)
