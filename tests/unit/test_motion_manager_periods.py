"""Period by period: a Motor for every Proprioceptor, no jump of any joint's torque, and what each fault leads to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bifrost import Message, Received
from harness.examples import examples
from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.common.behaviors import REFLEX, Behavior
from valor.common.messages import BehaviorRequest, JointMode, JointSetpoints, Motor, Proprioceptor, VelocityCommand
from valor.motion_manager.handlers.behavior import BehaviorHandler
from valor.motion_manager.handlers.joint_setpoints import JointSetpointsHandler
from valor.motion_manager.handlers.velocity import VelocityHandler
from valor.motion_manager.locomotion.balance import LONGEST_INFEASIBLE
from valor.motion_manager.manager import FAULTY, MotionManager
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model
from valor.whole_body.state import QpStatus, WholeBodyCommand

ROBOT = RobotDescription.load(ROBOTS / "escher")
MODEL = controller_model(ROBOT)
N = len(ROBOT.joints)
PERIOD = round(1e9 * ROBOT.control_period)
WEIGHT = float(MODEL.mj.body_subtreemass[0]) * 9.81
LIMIT = ROBOT.effort_limit


def tilted(angle: float) -> FloatArray:
    """Attitude of a pelvis that has turned forwards [rad]."""
    return np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])


class Robot:
    """What the devices of a robot say that stands quite still, and a Motion Manager that answers."""

    def __init__(self) -> None:
        self.manager = MotionManager(ROBOT, MODEL)
        self.time, self.sequence = 0, 0
        self.motor: Motor | None = None

    def proprioceptor(self, **changes: object) -> Proprioceptor:
        foot = np.array([0.0, 0.0, 0.5 * WEIGHT, 0.0, -0.02 * 0.5 * WEIGHT, 0.0])
        values: dict[str, object] = {
            "time": self.time, "sequence": self.sequence, "motor_sequence": 0,
            "joint_position": ROBOT.nominal_posture.copy(), "joint_velocity": np.zeros(N), "joint_effort": np.zeros(N),
            "imu_orientation": tilted(0.0), "imu_angular_velocity": np.zeros(3),
            "imu_linear_acceleration": np.array([0.0, 0.0, 9.81]),
            "left_foot_wrench": foot, "right_foot_wrench": foot.copy(),
            "left_hand_wrench": np.zeros(6), "right_hand_wrench": np.zeros(6), "battery_voltage": 48.0,
            "motor_behavior": "",
        }  # fmt: skip
        return Proprioceptor(**(values | changes))  # type: ignore[arg-type]

    def tick(self, elapsed: int = PERIOD, **changes: object) -> Motor:
        """One period of robot time, what the devices say, and the Motor that answers."""
        self.time += elapsed
        self.sequence += elapsed // PERIOD
        said = self.proprioceptor(**changes)
        before = 0 if self.motor is None else self.motor.sequence
        self.motor = self.manager.tick(said)
        assert self.motor.proprioceptor_sequence == said.sequence
        assert self.motor.sequence == before + 1
        assert self.motor.time == said.time
        self.check(self.motor)
        self.report()
        return self.motor

    @staticmethod
    def check(motor: Motor) -> None:
        for vector in (motor.position, motor.velocity, motor.effort, motor.stiffness, motor.damping):
            assert vector.shape == (N,)
            assert np.isfinite(vector).all()
        assert (np.abs(motor.effort) <= LIMIT).all()
        assert (motor.position >= ROBOT.lower).all() and (motor.position <= ROBOT.upper).all()
        assert motor.mode.shape == (N,)

    def report(self) -> Message:
        report = self.manager.report(1e-3)
        assert report.proprioceptor_sequence == self.sequence
        return report

    def run(self, seconds: float, **changes: object) -> None:
        for _ in range(round(seconds / ROBOT.control_period)):
            self.tick(**changes)

    @property
    def behavior(self) -> Behavior:
        return self.manager.fsm.behavior

    def ask(self, behavior: Behavior) -> str:
        """Request a behavior; returns the reason of a refusal."""
        reply = BehaviorHandler.of(self.manager.parts).handle(BehaviorRequest(behavior=behavior), "somebody")
        assert reply.accepted or reply.reason
        return "" if reply.accepted else reply.reason

    def torque(self) -> FloatArray:
        """What each joint's motor gives now, the joints standing where they stand."""
        motor = self.motor
        assert motor is not None
        error = motor.position - ROBOT.nominal_posture
        torque = motor.effort + (motor.mode != JointMode.FORCE) * (motor.stiffness * error)
        return np.where(motor.mode == JointMode.OFF, 0.0, torque)


@pytest.fixture
def robot() -> Robot:
    return Robot()


@pytest.fixture
def standing(robot: Robot) -> Robot:
    robot.run(1.0)
    assert not robot.ask(Behavior.STAND)
    robot.run(0.5)
    assert robot.behavior is Behavior.STAND
    return robot


def test_it_starts_idle_and_goes_to_stand_prep_with_the_first_proprioceptor(robot: Robot) -> None:
    assert robot.behavior is Behavior.IDLE
    assert "no comms_manager/proprioceptor yet" in robot.ask(Behavior.FREEZE)
    assert robot.manager.report(0.0).behavior == "idle"
    robot.tick()
    assert robot.behavior is Behavior.STAND_PREP
    assert robot.manager.custody.ours


def test_a_repeated_proprioceptor_is_answered_and_nothing_else(robot: Robot) -> None:
    for _ in range(100):
        robot.tick(elapsed=0)
    assert robot.behavior is Behavior.STAND_PREP
    assert robot.manager.fsm.changes == 1
    robot.run(1.0)
    assert not robot.ask(Behavior.STAND)


def test_stand_prep_moves_slowly_from_wherever_the_joints_are(robot: Robot) -> None:
    rng = np.random.default_rng(3)
    found = np.clip(ROBOT.nominal_posture + rng.uniform(-0.5, 0.5, N), ROBOT.lower, ROBOT.upper)
    last = robot.tick(joint_position=found).position
    assert np.allclose(last, found)
    fastest = 0.0
    for _ in range(1500):
        position = robot.tick(joint_position=found).position
        fastest = max(fastest, float(np.abs(position - last).max()) / ROBOT.control_period)
        last = position
    assert np.allclose(last, ROBOT.nominal_posture)
    assert fastest < 0.65


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"imu_orientation": tilted(0.4)}, "the pelvis is tilted"),
        ({"imu_orientation": tilted(-1.5)}, "the pelvis is tilted"),
        ({"left_foot_wrench": np.zeros(6)}, "the left foot carries 0 N"),
        ({"right_foot_wrench": np.zeros(6)}, "the right foot carries 0 N"),
        ({"joint_velocity": np.full(N, 1.0)}, "has not settled: joint 'l_hip_yaw' moves at"),
    ],
)
def test_stand_is_refused_to_a_robot_that_cannot(robot: Robot, changes: dict[str, object], reason: str) -> None:
    robot.run(1.0, **changes)
    assert reason in robot.ask(Behavior.STAND)
    assert robot.behavior is Behavior.STAND_PREP


def test_stand_is_refused_until_stand_prep_has_finished(robot: Robot) -> None:
    robot.tick()
    assert "to go" in robot.ask(Behavior.STAND)


def test_nobody_slips_through_stand_prep_between_two_periods(standing: Robot) -> None:
    assert not standing.ask(Behavior.FREEZE)
    assert not standing.ask(Behavior.STAND_PREP)
    assert "just begun" in standing.ask(Behavior.STAND)
    standing.tick()
    assert "to go" in standing.ask(Behavior.STAND)


def test_operation_drives_each_joint_as_robot_yaml_says(standing: Robot) -> None:
    motor = standing.tick()
    expected = {"force": JointMode.FORCE, "impedance": JointMode.IMPEDANCE, "position": JointMode.POSITION}
    for i, joint in enumerate(ROBOT.tables.joints.values()):
        assert motor.mode[i] == expected[joint.control]
        assert motor.stiffness[i] == (0.0 if joint.control == "force" else joint.servo.stiffness)
    legs = np.concatenate((ROBOT.group_indices("left_leg"), ROBOT.group_indices("right_leg")))
    assert np.abs(motor.effort[legs]).max() > 10.0


@pytest.mark.parametrize(
    "path",
    [
        (Behavior.STAND,),
        (Behavior.STAND, Behavior.STAND_PREP),
        (Behavior.STAND, Behavior.FREEZE, Behavior.STAND_PREP, Behavior.STAND),
        (Behavior.STAND, Behavior.STAND_MANIPULATE, Behavior.FREEZE, Behavior.IDLE),
        (Behavior.STAND, Behavior.SOFT_STOP, Behavior.STAND, Behavior.STAND_PREP),
        (Behavior.STAND, Behavior.STAND_PREP, Behavior.IDLE, Behavior.STAND_PREP, Behavior.STAND),
    ],
)
@pytest.mark.parametrize("pause", [0.1, 0.8])
def test_no_change_of_behavior_makes_a_torque_jump(robot: Robot, path: tuple[Behavior, ...], pause: float) -> None:
    robot.run(1.0)
    before, largest = robot.torque(), np.zeros(N)

    def watch() -> None:
        nonlocal before, largest
        robot.tick()
        torque = robot.torque()
        largest, before = np.maximum(largest, np.abs(torque - before)), torque

    for behavior in path:
        for _ in range(1000):
            if not robot.ask(behavior):
                break
            watch()
        assert robot.manager.fsm.behavior is behavior
        for _ in range(round(pause / ROBOT.control_period)):
            watch()
    # A blend of 0.3 s from nothing to the largest torque, and half as much again for the controller's own dynamics.
    allowed = 1.5 * ROBOT.control_period / 0.3 * np.maximum(LIMIT, 30.0)
    assert (largest < allowed).all(), ROBOT.joints[int(np.argmax(largest / allowed))]


def test_a_restart_takes_the_joints_over_with_the_efforts_they_have(robot: Robot) -> None:
    effort = np.where(np.arange(N) < 27, 0.5 * LIMIT, 0.0)
    robot.tick(joint_effort=effort)
    assert np.allclose(robot.torque(), effort)


def test_a_fall_makes_the_motors_limp_in_the_same_period(standing: Robot) -> None:
    motor = standing.tick(imu_orientation=tilted(1.2))  # the attitude's filter sees it within a few periods
    for _ in range(2000):
        if standing.behavior is Behavior.FALL:
            break
        motor = standing.tick(imu_orientation=tilted(1.2))
    assert standing.behavior is Behavior.FALL
    assert "tilted" in standing.manager.fsm.reason or "DCM" in standing.manager.fsm.reason
    assert not motor.effort.any()
    assert not motor.stiffness.any()
    standing.run(0.5)  # upright again
    assert standing.behavior is Behavior.FALL


@pytest.mark.parametrize("behavior", [Behavior.STAND, Behavior.FREEZE, Behavior.FALL])
@pytest.mark.parametrize(("stop", "further"), [("upper", 0.05), ("lower", -0.05)])
def test_joints_found_beyond_their_stops_are_not_commanded_there(
    standing: Robot, behavior: Behavior, stop: str, further: float
) -> None:
    """``check`` looks at every Motor."""
    stops = getattr(ROBOT, stop)
    standing.ask(behavior)
    standing.run(0.01, joint_position=np.where(np.isfinite(stops), stops + further, 0.0))


def test_a_world_begun_anew_is_a_fall(standing: Robot) -> None:
    standing.time, standing.sequence = 0, standing.sequence + 1_000_000
    motor = standing.tick()
    assert standing.behavior is Behavior.FALL
    assert "another world" in standing.manager.fsm.reason
    assert not motor.effort.any()


def test_a_robot_that_stood_without_us_for_a_while_is_held(standing: Robot) -> None:
    standing.tick(elapsed=40 * PERIOD)
    assert standing.behavior is Behavior.STAND
    assert standing.manager.missed == 39
    effort = np.where(np.arange(N) < 27, 0.1 * LIMIT, 0.0)
    motor = standing.tick(elapsed=60 * PERIOD, joint_effort=effort)
    assert standing.behavior is Behavior.FREEZE
    assert "no Proprioceptor for 0.120 s of robot time" in standing.manager.fsm.reason
    assert np.allclose(motor.position, ROBOT.nominal_posture) and np.allclose(standing.torque(), effort)
    standing.run(0.1)
    assert not standing.ask(Behavior.STAND_PREP)
    standing.run(1.0)
    assert not standing.ask(Behavior.STAND), "the way back"


def test_a_robot_that_walks_on_the_spot_is_held_too(standing: Robot) -> None:
    assert not standing.ask(Behavior.WALK)
    standing.run(0.1)
    standing.tick(elapsed=60 * PERIOD)
    assert standing.behavior is Behavior.FREEZE


@pytest.mark.parametrize(
    ("found", "why"),
    [
        ({"imu_orientation": tilted(0.5)}, "the pelvis is tilted"),
        ({"left_foot_wrench": np.zeros(6), "right_foot_wrench": np.zeros(6)}, "foot carries 0 N"),
    ],
)
def test_a_robot_that_is_found_lying_is_let_go(standing: Robot, found: dict[str, object], why: str) -> None:
    motor = standing.tick(elapsed=60 * PERIOD, **found)
    assert standing.behavior is Behavior.FALL
    assert why in standing.manager.fsm.reason
    assert not motor.effort.any()


@pytest.fixture
def stepping(standing: Robot) -> Robot:
    assert not standing.ask(Behavior.WALK)
    VelocityHandler.of(standing.manager.parts).handle(
        Received(VelocityCommand(standing.time, 0.2, 0.0, 0.0), 0, 1, "valor_ros_controller"), standing.time
    )
    for _ in range(1000):
        standing.tick()
        if standing.manager.parts.conditions().stepping:
            break
    return standing


@pytest.mark.parametrize(
    ("speed", "found", "why"),
    [(1.0, Behavior.FALL, "it was stepping, and moves"), (0.0, Behavior.FREEZE, "it stands, and is held")],
)
def test_a_robot_that_was_stepping_without_us_is_let_go_unless_it_has_come_to_rest(
    stepping: Robot, speed: float, found: Behavior, why: str
) -> None:
    stepping.tick(elapsed=60 * PERIOD, joint_velocity=np.full(N, speed))
    assert stepping.behavior is found
    assert why in stepping.manager.fsm.reason


def aside(robot: Robot, seconds: float = 0.1, **changes: object) -> None:
    """The Comms Manager's reflex has the robot."""
    for _ in range(round(seconds / ROBOT.control_period)):
        motor = robot.tick(motor_behavior=REFLEX, **changes)
        assert motor.behavior == REFLEX
    assert "the Comms Manager brings the robot to stand" in robot.ask(Behavior.STAND)
    assert not robot.manager.custody.ours


def test_a_new_motion_manager_waits_for_the_reflex_and_holds_what_it_leaves() -> None:
    robot = Robot()
    aside(robot, left_foot_wrench=np.zeros(6))
    assert robot.behavior is Behavior.SOFT_STOP
    found = np.clip(ROBOT.nominal_posture + 0.1, ROBOT.lower, ROBOT.upper)
    motor = robot.tick(motor_behavior="walk", joint_position=found)
    assert robot.behavior is Behavior.FREEZE
    assert np.array_equal(motor.position, found)
    robot.run(0.1)
    assert not robot.ask(Behavior.STAND_PREP)


def test_one_that_walked_and_was_stopped_does_not_go_on_walking(stepping: Robot) -> None:
    stepping.time += 100 * PERIOD
    aside(stepping, left_foot_wrench=np.zeros(6))
    assert stepping.behavior is Behavior.SOFT_STOP
    stepping.run(0.1, motor_behavior="walk")
    assert stepping.behavior is Behavior.FREEZE
    assert "the Comms Manager brought the robot to stand" in stepping.manager.fsm.reason


def test_what_the_reflex_leaves_on_one_foot_is_let_go(stepping: Robot) -> None:
    aside(stepping)
    stepping.run(0.1, motor_behavior="walk", left_foot_wrench=np.zeros(6))
    assert stepping.behavior is Behavior.FALL


def test_a_robot_that_was_let_go_stays_so_beside_the_reflex(standing: Robot) -> None:
    assert not standing.ask(Behavior.FALL)
    for _ in range(10):
        assert standing.tick(motor_behavior=REFLEX).behavior == Behavior.FALL
    standing.run(0.1, motor_behavior="fall")
    assert standing.behavior is Behavior.FALL


def test_in_stand_prep_a_new_world_is_held_as_it_is_found(robot: Robot) -> None:
    robot.run(1.0)
    robot.time = 0
    found = np.clip(ROBOT.nominal_posture + 0.1, ROBOT.lower, ROBOT.upper)
    motor = robot.tick(joint_position=found)
    assert robot.behavior is Behavior.FREEZE
    assert np.allclose(motor.position, found)
    assert not robot.ask(Behavior.STAND_PREP)
    assert "begun" in robot.ask(Behavior.STAND)


def broken(name: str, value: object) -> dict[str, object]:
    return {name: value}


BROKEN = [
    broken("joint_position", np.full(N, np.nan)),
    broken("joint_velocity", np.zeros(N - 1)),
    broken("joint_effort", np.full(N, np.inf)),
    broken("imu_orientation", np.zeros(4)),
    broken("imu_angular_velocity", np.zeros(0)),
    broken("imu_linear_acceleration", np.array([0.0, np.nan, 0.0])),
    broken("left_foot_wrench", np.zeros(7)),
    broken("right_hand_wrench", np.full(6, -np.inf)),
]


@pytest.mark.parametrize("changes", BROKEN)
def test_one_broken_proprioceptor_is_refused_and_survived(standing: Robot, changes: dict[str, object]) -> None:
    before = standing.motor
    assert before is not None
    motor = standing.tick(**changes)
    assert standing.behavior is Behavior.STAND
    assert np.array_equal(motor.effort, before.effort)
    assert (motor.damping >= before.damping).all()
    (rejection,) = standing.manager.rejections.take()
    assert next(iter(changes)) in rejection.reason
    standing.run(0.5)
    assert standing.behavior is Behavior.STAND


@pytest.mark.parametrize("changes", BROKEN)
def test_broken_proprioceptors_in_a_row_are_a_fall(standing: Robot, changes: dict[str, object]) -> None:
    for _ in range(round(FAULTY / ROBOT.control_period)):
        assert standing.behavior is Behavior.STAND
        motor = standing.tick(**changes)
    assert standing.behavior is Behavior.FALL
    assert next(iter(changes)) in standing.manager.fsm.reason
    assert not motor.effort.any()


def test_numbers_whose_squares_are_finite_but_not_their_sum_are_refused(standing: Robot) -> None:
    large = np.full(N, np.sqrt(1e308 / N))
    standing.tick(joint_velocity=large, joint_effort=large)
    (rejection,) = standing.manager.rejections.take()
    assert "too large" in rejection.reason
    standing.run(0.1)
    assert standing.behavior is Behavior.STAND


def test_a_robot_that_never_makes_sense_is_never_in_control(robot: Robot) -> None:
    for _ in range(50):
        motor = robot.tick(joint_position=np.full(N, np.nan))
    assert not motor.effort.any()
    assert robot.behavior is Behavior.IDLE
    assert not robot.manager.custody.ours


def interfere(robot: Robot, change: Callable[[WholeBodyCommand], WholeBodyCommand]) -> None:
    """Spoil what the Whole-Body Controller commands."""
    update = robot.manager.parts.controller.update
    robot.manager.parts.controller.update = lambda *arguments: change(update(*arguments))  # type: ignore[method-assign]


def test_a_command_that_is_not_finite_never_leaves(standing: Robot) -> None:
    before = standing.motor
    assert before is not None
    interfere(standing, lambda command: replace(command, effort=np.full(N, np.nan)))
    motor = standing.tick()
    assert np.array_equal(motor.effort, before.effort)
    assert standing.manager.parts.command.replaced == 1


def test_efforts_beyond_the_limits_are_clamped_and_counted(standing: Robot) -> None:
    interfere(standing, lambda command: replace(command, effort=np.full(N, 1e6)))
    count = standing.manager.report(0.0).torque_saturations
    motor = standing.tick()
    assert motor.effort.max() <= LIMIT.max()
    assert standing.manager.report(0.0).torque_saturations > count


def test_an_infeasible_qp_leads_to_soft_stop_and_not_at_once(standing: Robot) -> None:
    interfere(standing, lambda command: replace(command, qp_status=QpStatus.INFEASIBLE))
    for _ in range(round(LONGEST_INFEASIBLE / ROBOT.control_period) - 1):
        standing.tick()
        assert standing.behavior is Behavior.STAND
    standing.tick()
    assert standing.behavior is Behavior.SOFT_STOP
    assert "infeasible for 25 periods" in standing.manager.fsm.reason
    standing.run(0.2)
    assert standing.behavior is Behavior.SOFT_STOP


def test_an_error_of_ours_repeats_the_last_command_and_then_falls(standing: Robot) -> None:
    before = standing.motor
    assert before is not None

    def fail(command: WholeBodyCommand) -> WholeBodyCommand:
        raise RuntimeError("broken on purpose")

    interfere(standing, fail)
    motor = standing.tick()
    assert np.array_equal(motor.effort, before.effort)
    assert standing.behavior is Behavior.STAND
    for _ in range(round(FAULTY / ROBOT.control_period)):
        motor = standing.tick()
    assert standing.behavior is Behavior.FALL
    assert not motor.effort.any()


values = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1.0, -3.0, 1e9, 1e300])


@examples(8)
@given(st.data())
@np.errstate(all="ignore")
def test_whatever_happens_every_proprioceptor_gets_its_sound_motor(data: st.DataObject) -> None:
    robot = Robot()
    robot.run(0.9)
    for _ in range(data.draw(st.integers(1, 12))):
        event = data.draw(st.sampled_from(["ask", "broken", "gap", "anew", "setpoint", "nothing"]))
        if event == "ask":
            robot.ask(data.draw(st.sampled_from(Behavior)))
        elif event == "broken":
            name = data.draw(st.sampled_from([next(iter(changes)) for changes in BROKEN]))
            value = np.full(data.draw(st.sampled_from([N, 3, 4, 6, 0])), data.draw(values))
            for _ in range(data.draw(st.integers(1, 7))):
                robot.tick(**{name: value})
        elif event == "gap":
            robot.tick(elapsed=PERIOD * data.draw(st.integers(1, 100)))
        elif event == "anew":
            robot.time = 0
        elif event == "setpoint":
            position = np.full(1, data.draw(values))
            message = JointSetpoints(robot.time, ["neck_yaw"], position, np.zeros(1), np.zeros(1))
            JointSetpointsHandler.of(robot.manager.parts).handle(
                Received(message, 0, 1, "somebody"), robot.manager.time
            )
        robot.run(0.04)
        assert robot.manager.custody.ours


SAID = {
    "joint_position": N, "joint_velocity": N, "joint_effort": N,
    "imu_orientation": 4, "imu_angular_velocity": 3, "imu_linear_acceleration": 3,
    "left_foot_wrench": 6, "right_foot_wrench": 6, "left_hand_wrench": 6, "right_hand_wrench": 6,
}  # fmt: skip
numbers = st.one_of(st.floats(), st.floats(-1e3, 1e3), st.floats(-4.0, 4.0))  # any at all, absurd, and believable
slips = st.tuples(st.sampled_from(sorted(SAID)), st.integers(0, N - 1), numbers)


@examples(8)
@given(st.lists(st.lists(slips, min_size=1, max_size=6), min_size=1, max_size=8))
@np.errstate(all="ignore")
def test_whatever_single_sensors_say_while_it_balances_the_motors_are_sound(
    periods: list[list[tuple[str, int, float]]],
) -> None:
    """Every Motor is checked by ``tick``: finite, torques within limits."""
    robot = Robot()
    robot.run(1.0)
    assert not robot.ask(Behavior.STAND)
    robot.run(0.4)
    for period in periods:
        sound, changes = robot.proprioceptor(), {}
        for name, place, number in period:
            vector = changes.setdefault(name, getattr(sound, name).copy())
            vector[place % SAID[name]] = number
        robot.tick(**changes)
    robot.run(0.1)
    assert robot.behavior in (Behavior.STAND, Behavior.FALL, Behavior.SOFT_STOP)
