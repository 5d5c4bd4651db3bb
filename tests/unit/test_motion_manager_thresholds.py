"""Where "enough" and "too much" begin: every condition of the Motion Manager on both sides of its limit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from bifrost import Received
from harness.examples import examples
from harness.still_robot import PERIOD, ROBOT, WEIGHT, N, Robot, tilted
from tests.unit.test_motion_manager_bypass import goal, lead, standing
from valor.common.arrays import FloatArray
from valor.common.messages import BalanceWeights, Proprioceptor
from valor.common.rotation import NORM
from valor.control.tuning_tables import Tuning
from valor.control.watchdog import LONGEST_GAP, ProprioceptorWatchdog
from valor.motion_manager.handlers.handler import STALE, RejectionCounter
from valor.motion_manager.handlers.motion import FARTHEST
from valor.motion_manager.handlers.tuning import BalanceWeightsHandler
from valor.motion_manager.hands.hand_loads import HandContacts
from valor.motion_manager.safety import FEET_LOAD, FOOT_LOAD, UPRIGHT, Stance

TILT = UPRIGHT * ROBOT.read(Tuning).fall.tilt
FOUND = Robot()
FOUND.tick()
_state = FOUND.manager.components.state
assert _state is not None
STATE = _state
STANCE = Stance(ROBOT, WEIGHT)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
@examples(60)
def test_the_feet_carry_enough_each_and_together(left: float, right: float) -> None:
    assume(min(abs(left - FOOT_LOAD), abs(right - FOOT_LOAD), abs(left + right - FEET_LOAD)) > 1e-3)
    reported = STANCE.lost(replace(STATE, foot_forces=WEIGHT * np.array((left, right))))
    if left < FOOT_LOAD:
        assert reported.startswith("the left foot carries")
    elif right < FOOT_LOAD:
        assert reported.startswith("the right foot carries")
    elif left + right < FEET_LOAD:
        assert reported.startswith("the feet carry")
    else:
        assert reported == ""


@given(st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi))
@examples(60)
def test_upright_is_a_pelvis_whose_axis_is_near_the_vertical_wherever_it_heads(tilt: float, heading: float) -> None:
    assume(abs(abs(tilt) - TILT) > 1e-3)
    c, s, ch, sh = np.cos(tilt), np.sin(tilt), np.cos(heading), np.sin(heading)
    turned = np.array([[ch, -sh, 0.0], [sh, ch, 0.0], [0.0, 0.0, 1.0]]) @ [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
    reported = STANCE.lost(replace(STATE, pelvis_rotation_in_odom=turned))
    assert reported.startswith("the pelvis is tilted") == (abs(tilt) > TILT)
    assert (reported == "") == (abs(tilt) < TILT)


# --- what comes from the robot ------------------------------------------------------------------------------------
@given(st.lists(st.tuples(st.integers(-3, 80), st.integers(-3, 80)), min_size=1, max_size=8))
@examples(100)
def test_a_gap_is_what_lies_between_two_states_and_all_between_is_missed(steps: list[tuple[int, int]]) -> None:
    watchdog, time, sequence, missed = ProprioceptorWatchdog(N), 10**9, 1000, 0
    assert watchdog.discontinuity(FOUND.proprioceptor(time=time, sequence=sequence)) is None
    for passed, numbers in steps:
        time, sequence = time + passed * PERIOD, sequence + numbers
        said = FOUND.proprioceptor(time=time, sequence=sequence)
        assert watchdog.repeated(said) == (passed == 0 and numbers == 0)
        gap = watchdog.discontinuity(said)
        if passed <= 0 or numbers <= 0:
            assert gap is not None and not gap.same_world and "another world" in gap.reason
        else:
            missed += numbers - 1
            long = passed * PERIOD > LONGEST_GAP * 1e9
            assert (gap is not None) == long
            assert gap is None or (gap.same_world and gap.reason.startswith("no Proprioceptor for"))
        assert watchdog.missed == missed


@pytest.mark.parametrize(("norm", "sound"), [(0.994, False), (0.996, True), (1.004, True), (1.006, False)])
def test_an_attitude_is_a_unit_quaternion(norm: float, sound: bool) -> None:
    watchdog = ProprioceptorWatchdog(N)
    said = FOUND.proprioceptor(imu_orientation=norm * tilted(0.3))
    for malformed in range(1, 4):
        assert (watchdog.fault(said) == "") == sound
        assert watchdog.malformed == (0 if sound else malformed)
    assert watchdog.fault(FOUND.proprioceptor()) == ""
    assert watchdog.malformed == 0, "in a row"


VECTORS = [
    name for name in Proprioceptor.__struct_fields__
    if isinstance(getattr(FOUND.proprioceptor(), name), np.ndarray) and not name.startswith("kvh_")
]  # fmt: skip  # the Motion Manager reads nothing of the second IMU


@pytest.mark.parametrize("name", VECTORS)
def test_each_vector_has_its_length_and_is_finite(name: str) -> None:
    watchdog = ProprioceptorWatchdog(N)
    sound = getattr(FOUND.proprioceptor(), name)
    size = len(sound)
    for wrong in (sound[:-1], np.append(sound, 0.0)):
        said = FOUND.proprioceptor(**{name: wrong})
        assert watchdog.fault(said) == f"{name} has {len(wrong)} numbers; expected {size}"
    for number in (np.nan, np.inf, -np.inf):
        broken = sound.copy()
        broken[-1] = number
        assert watchdog.fault(FOUND.proprioceptor(**{name: broken})) == f"{name} is not finite"
    assert watchdog.malformed == 5


def test_numbers_whose_squares_are_finite_each_and_not_together_are_not_believed() -> None:
    large = {name: np.eye(1, N)[0] * 1e154 for name in ("joint_position", "joint_velocity")}
    assert ProprioceptorWatchdog(N).fault(FOUND.proprioceptor(**large)) == "its numbers are too large to be true"


forces = st.floats(0.0, 30.0) | st.sampled_from([ROBOT.tables.hands.contact_on, ROBOT.tables.hands.contact_off])


@given(st.lists(st.tuples(forces, forces, st.integers(0, 2)), min_size=1, max_size=12))
@examples(60)
def test_a_hand_touches_from_the_one_force_on_until_the_other(felt: list[tuple[float, float, int]]) -> None:
    hands = ROBOT.tables.hands
    contacts = HandContacts(hands)
    expected = [0, 0]
    for left, right, axis in felt:
        wrenches = []
        for side, force in enumerate((left, right)):
            wrench = np.full(6, 1000.0)  # its torque does not count
            wrench[:3] = 0.0
            wrench[axis] = -force if side else force
            wrenches.append(wrench)
            expected[side] = int(force**2 > (hands.contact_off if expected[side] else hands.contact_on) ** 2)
        before = contacts.contacts
        contacts.update(FOUND.proprioceptor(left_hand_wrench=wrenches[0], right_hand_wrench=wrenches[1]))
        assert contacts.contacts.tolist() == expected and contacts.touching == any(expected)
        assert (contacts.contacts is before) == np.array_equal(contacts.contacts, before)


# --- what comes from others ---------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def manipulating() -> Robot:
    return standing()


def beside(length: float) -> FloatArray:
    return np.array((0.0, length, 0.0))


@pytest.mark.parametrize(
    ("changes", "obeyed"),
    [
        ({"hand": -1}, False),
        ({"hand": 2}, False),
        ({"frame": "map"}, False),
        ({"position": np.full(3, np.nan)}, False),
        ({"hand": 0}, True),
        ({"frame": "odom"}, True),
        ({"position": beside(-FARTHEST)}, True),
        ({"position": beside(-FARTHEST - 0.01)}, False),
        ({"position": np.full(3, FARTHEST)}, True),
        ({"position": np.zeros(4)}, False),
        ({"orientation": np.array((0.0, 1.0 + 0.9 * NORM, 0.0, 0.0))}, True),
        ({"orientation": np.array((0.0, 1.0 + 1.1 * NORM, 0.0, 0.0))}, False),
        ({"orientation": np.array((0.0, 1.0 - 1.1 * NORM, 0.0, 0.0))}, False),
        ({"orientation": np.array((0.0, np.inf, 0.0, 0.0))}, False),
        ({"orientation": np.array((0.0, 1.0, 0.0))}, False),
        ({"age": STALE - 0.01}, True),
        ({"age": STALE + 0.01}, False),
        ({"age": -STALE + 0.01}, True),
        ({"age": -STALE - 0.01}, False),
        ({"active": False, "frame": "nowhere", "position": np.zeros(0)}, True),
    ],
)
def test_a_hand_goal_is_obeyed_within_its_limits(manipulating: Robot, changes: dict[str, object], obeyed: bool) -> None:
    robot, age = manipulating, float(changes.get("age", 0.0))  # type: ignore[arg-type]
    wanted = {key: value for key, value in changes.items() if key != "age"}
    wanted = {"position": beside(0.3), "time": robot.time - round(1e9 * age)} | wanted
    for side in (0, 1):
        robot.manager.components.hand_goals.release(side, "test")
    assert lead(robot, goal(robot, **wanted), str(changes)) is obeyed
    side = int(wanted.get("hand", 1))  # type: ignore[call-overload]
    led = [robot.manager.components.hand_goals.leads(each) for each in (0, 1)]
    assert led == [obeyed and wanted.get("active", True) is True and each == side for each in (0, 1)]
    for each in (0, 1):
        robot.manager.components.hand_goals.release(each, "test")


@pytest.mark.parametrize("weight", [-1e-9, np.nan, np.inf])
def test_a_weight_is_a_finite_number_that_is_not_negative(manipulating: Robot, weight: float) -> None:
    manager = manipulating.manager
    asked = manager.components.whole_body.weights.requested.copy()
    message = BalanceWeights(["com"], np.array((weight,)))
    assert not BalanceWeightsHandler(manager.components).handle(Received(message, 0, 1, f"{weight}"), 0)
    assert not BalanceWeightsHandler(manager.components).handle(
        Received(BalanceWeights([], np.zeros(0)), 0, 1, f"none {weight}"), 0
    )
    np.testing.assert_array_equal(manager.components.whole_body.weights.requested, asked)
    assert BalanceWeightsHandler(manager.components).handle(
        Received(BalanceWeights(["com"], np.zeros(1)), 0, 1, "zero"), 0
    )
    assert manager.components.whole_body.weights.requested[0] == manager.components.whole_body.weights.lower[0]


def test_refusals_are_counted_by_topic_sender_and_kind_within_bounds(caplog: pytest.LogCaptureFixture) -> None:
    rejections = RejectionCounter()
    kinds = [(topic, origin, kind) for topic in "ab" for origin in "cd" for kind in "ef"]
    for _ in range(3):
        for topic, origin, kind in kinds:
            rejections.add(topic, origin, kind, "why")
    reported = rejections.take()
    assert [(each.topic, each.origin, each.count) for each in reported] == [
        (topic, origin, 1 + i % 4) for i, (topic, origin, _) in enumerate(kinds)
    ]
    assert {each.reason for each in reported} == {"why"}
    assert rejections.take() == []
    assert (rejections.count("a"), rejections.count("b"), rejections.count("z"), rejections.total) == (12, 12, 0, 24)
    assert len(caplog.records) == len(kinds)
    for i in range(1000):
        rejections.add("a", f"stranger {i}", "e", "why")
    assert len(rejections._published) < 1000
