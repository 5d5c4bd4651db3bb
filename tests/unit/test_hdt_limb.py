"""What the HDT driver lets through to a limb's modules, whatever is asked of it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.places import ROBOTS
from valor.devices.hdt_bus import Fault, SegmentState, Setpoints
from valor.hdt_driver.limb import ENGAGE, JUMP, SILENCE, Command, Limb
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
ARM = "right_arm"
PERIOD = 0.01
PLACES = ROBOT.group_indices(ARM)
LOWER, UPPER, SPEED, EFFORT = (
    values[PLACES] for values in (ROBOT.lower, ROBOT.upper, ROBOT.velocity_limit, ROBOT.effort_limit)
)
K = len(PLACES)
HOME = np.array([ROBOT.tables.arm_presets["home"]["right"][joint] for joint in ROBOT.tables.groups[ARM]])


def asked(position: np.ndarray, **changes: Any) -> Setpoints:
    zero = np.zeros(K)
    whole = Setpoints(np.full(K, 2, np.uint8), position, zero, zero, zero + 300.0, zero + 12.0)
    return replace(whole, **changes)


def answer(limb: Limb, position: np.ndarray, frame: int = 0, fault: int = 0, first: int = 0) -> None:
    """All segments say their state, or all from the first on."""
    for part in limb.parts[first:]:
        n = part.stop - part.start
        zero = np.zeros(n)
        faults = np.full(n, fault, dtype=np.uint8)
        limb.measured(part, SegmentState(frame, 1, 48.0, position[part], zero, zero, zero + 30.0, faults))


def make(position: np.ndarray = HOME) -> Limb:
    limb = Limb(ROBOT, ARM, PERIOD)
    answer(limb, position)
    return limb


def test_nothing_is_told_before_the_limb_is_known_or_anybody_has_asked() -> None:
    limb = Limb(ROBOT, ARM, PERIOD)
    limb.take(Command(1, asked(HOME)), 0.0)
    assert limb.setpoints(1, 0.0) is None, "nobody knows where it is"
    assert make().setpoints(1, 0.0) is None, "nobody has asked for anything"


@pytest.mark.parametrize(
    ("setpoints", "why"),
    [
        (asked(HOME[:-1]), "wrong length"),
        (asked(np.full(K, math.nan)), "not finite"),
        (asked(HOME, effort=np.full(K, math.inf)), "not finite"),
        (asked(HOME, mode=np.full(K, 4, np.uint8)), "unknown mode"),
        (asked(HOME, stiffness=np.full(K, -1.0)), "negative gain"),
        (asked(np.zeros(0), mode=np.zeros(0, np.uint8)), "wrong length"),
    ],
)
def test_an_unsound_command_moves_nothing(setpoints: Setpoints, why: str, caplog: pytest.LogCaptureFixture) -> None:
    limb = make()
    limb.take(Command(1, setpoints), 0.0)
    assert limb.refused == 1 and why in caplog.text
    assert limb.setpoints(1, 0.0) is None


def test_a_far_first_set_point_is_refused_by_name_and_a_near_one_leads(caplog: pytest.LogCaptureFixture) -> None:
    limb = make()
    far = HOME.copy()
    far[3] += 2 * ENGAGE
    limb.take(Command(1, asked(far)), 0.0)
    told = limb.setpoints(1, 0.0)
    assert told is not None and not limb.led
    assert told.position[3] == pytest.approx(HOME[3]), "the far joint stays"
    assert f"{limb.joints[3]}: the first set-point is" in caplog.text
    limb.take(Command(2, asked(HOME)), 0.01)
    told = limb.setpoints(2, 0.01)
    assert told is not None and limb.led
    assert told.position == pytest.approx(HOME)


@examples(60)
@given(st.integers(0, 2**32 - 1))
def test_set_points_never_jump_whatever_is_asked_and_whatever_fails(seed: int) -> None:
    random = np.random.default_rng(seed)
    limb, joint, step = make(), HOME.copy(), 1.5 * SPEED * PERIOD
    before, led_before = joint.copy(), np.zeros(K, dtype=bool)
    for cycle in range(1, 60):
        now = cycle * PERIOD
        event = random.choice(["command", "command", "command", "nothing", "silent", "back"])
        if event == "command":
            wanted = joint + 0.02 * random.normal(size=K) if random.random() < 0.5 else random.uniform(-6, 6, K)
            limb.take(Command(cycle, asked(wanted, effort=random.uniform(-500, 500, K))), now)
        elif event == "silent":
            limb.silent(limb.parts[0])
            led_before[limb.parts[0]] = False
        elif event == "back":
            if limb.fault.any():  # it was limp meanwhile
                part = limb.parts[0]
                joint[part] = before[part] = np.clip(joint[part] + random.uniform(-0.5, 0.5), LOWER[part], UPPER[part])
            answer(limb, joint)
        told, led = limb.setpoints(cycle, now), limb._led
        if told is None:
            led_before = led.copy()
            continue
        assert (told.position >= LOWER - 1e-9).all() and (told.position <= UPPER + 1e-9).all()
        assert (np.abs(told.effort) <= EFFORT).all() and (np.abs(told.velocity) <= SPEED).all()
        moved = np.abs(told.position - before)
        goes, begins = led & led_before, led & ~led_before
        assert (moved[goes] <= step[goes] + 1e-9).all(), "who is led moves no quicker than it can"
        assert (np.abs(told.position - joint)[begins] <= ENGAGE + step[begins]).all(), "it begins where the joint is"
        assert (moved[~led] < 1e-9).all(), "who is not led stays"
        before, led_before = told.position.copy(), led.copy()
        joint = np.where(led, told.position, joint)
        answer(limb, joint, first=1 if limb.fault.any() else 0)


def test_without_commands_it_stays_and_the_next_must_begin_where_it_is() -> None:
    limb = make()
    limb.take(Command(1, asked(HOME, velocity=np.full(K, 0.5))), 0.0)
    limb.setpoints(1, 0.0)
    assert limb.led
    told = limb.setpoints(2, SILENCE + PERIOD)
    assert told is not None and not limb.led
    assert told.position == pytest.approx(HOME) and not told.velocity.any()
    assert limb.setpoints(3, SILENCE + 2 * PERIOD) is None
    limb.take(Command(2, asked(HOME + 2 * ENGAGE)), 1.0)
    told = limb.setpoints(4, 1.0)
    assert told is not None and told.position == pytest.approx(HOME)


def test_a_segment_that_was_away_is_found_where_it_is() -> None:
    limb = make()
    limb.take(Command(1, asked(HOME)), 0.0)
    limb.setpoints(1, 0.0)
    limb.silent(limb.parts[1])
    assert (limb.fault[limb.parts[1]] & Fault.NO_ANSWER).all() and not limb.fault[limb.parts[0]].any()
    sunk = HOME + 0.5
    answer(limb, np.where(np.arange(K) >= limb.parts[1].start, sunk, HOME))
    limb.take(Command(2, asked(HOME)), 0.02)
    told = limb.setpoints(2, 0.02)
    assert told is not None
    assert told.position[limb.parts[1]] == pytest.approx(sunk[limb.parts[1]]), "it is not torn back"
    assert told.position[limb.parts[0]] == pytest.approx(HOME[limb.parts[0]])


def test_an_encoder_that_jumps_is_not_believed_until_it_says_the_old_again() -> None:
    limb = make()
    limb.take(Command(1, asked(HOME)), 0.0)
    limb.setpoints(1, 0.0)
    answer(limb, np.where(np.arange(K) == 2, HOME + 2 * JUMP, HOME))
    assert limb.fault[2] & Fault.ENCODER and limb.position == pytest.approx(HOME)
    limb.take(Command(2, asked(HOME + 0.01)), 0.01)
    told = limb.setpoints(2, 0.01)
    assert told is not None
    assert told.position[2] == pytest.approx(HOME[2]) and told.position[3] > HOME[3]
    answer(limb, HOME)
    assert not limb.fault.any()
    limb.setpoints(3, 0.02)
    assert limb.led


def test_states_say_which_command_they_answer() -> None:
    limb = make()
    limb.take(Command(4711, asked(HOME)), 0.0)
    limb.setpoints(17, 0.0)
    assert limb.obeyed == 0
    answer(limb, HOME, frame=17)
    assert limb.obeyed == 4711
