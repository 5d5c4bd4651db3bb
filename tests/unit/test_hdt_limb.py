"""Commands that the HDT driver sends to a limb's modules."""

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
from valor.devices.hdt_bus import Fault, state_layout
from valor.hdt_driver.limb import ENGAGE, JUMP, SILENCE, Limb, Setpoints
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


def command(position: np.ndarray, sequence: int = 1, **changes: Any) -> Setpoints:
    zero = np.zeros(K)
    values = Setpoints(sequence, np.full(K, 2, np.uint8), position, zero, zero, zero + 300.0, zero + 12.0)
    return replace(values, **changes)


def report(limb: Limb, position: np.ndarray, fault: int | np.ndarray = 0) -> None:
    state = np.zeros(1, state_layout(K))[0]
    state["position"], state["temperature"], state["fault"] = position, 30.0, fault
    limb.measured(state)


def make(position: np.ndarray = HOME) -> Limb:
    limb = Limb(ROBOT, ARM, PERIOD)
    report(limb, position)
    return limb


def test_nothing_is_reported_before_the_limb_is_known_or_anybody_has_command() -> None:
    limb = Limb(ROBOT, ARM, PERIOD)
    limb.accept(command(HOME, sequence=1), 0.0)
    assert limb.setpoints(0.0) is None, "its position is not available"
    assert make().setpoints(0.0) is None, "no command"


@pytest.mark.parametrize(
    ("setpoints", "why"),
    [
        (command(HOME[:-1]), "wrong length"),
        (command(np.full(K, math.nan)), "not finite"),
        (command(HOME, effort=np.full(K, math.inf)), "not finite"),
        (command(HOME, mode=np.full(K, 4, np.uint8)), "unknown mode"),
        (command(HOME, stiffness=np.full(K, -1.0)), "negative gain"),
        (command(np.zeros(0), mode=np.zeros(0, np.uint8)), "wrong length"),
    ],
)
def test_an_invalid_command_is_rejected(setpoints: Setpoints, why: str, caplog: pytest.LogCaptureFixture) -> None:
    limb = make()
    limb.accept(setpoints, 0.0)
    assert limb.rejected == 1 and why in caplog.text and limb.setpoints(0.0) is None


def test_a_far_first_set_point_is_rejected_and_a_near_one_engages(caplog: pytest.LogCaptureFixture) -> None:
    limb = make()
    far = HOME.copy()
    far[3] += 2 * ENGAGE
    limb.accept(command(far, sequence=1), 0.0)
    sent = limb.setpoints(0.0)
    assert sent is not None and not limb.engaged
    assert sent.position[3] == pytest.approx(HOME[3]), "the far joint holds"
    assert f"{limb.joints[3]}: the first set-point is" in caplog.text
    limb.accept(command(HOME, sequence=2), 0.01)
    sent = limb.setpoints(0.01)
    assert sent is not None and limb.engaged and sent.position == pytest.approx(HOME)


@examples(60)
@given(st.integers(0, 2**32 - 1))
def test_set_points_never_jump_for_any_command_or_fault(seed: int) -> None:
    random = np.random.default_rng(seed)
    limb, joint, step = make(), HOME.copy(), 1.5 * SPEED * PERIOD
    before, engaged_before = joint.copy(), np.zeros(K, dtype=bool)
    for cycle in range(1, 60):
        now = cycle * PERIOD
        event = random.choice(["command", "command", "command", "nothing", "silent", "back"])
        if event == "command":
            wanted = joint + 0.02 * random.normal(size=K) if random.random() < 0.5 else random.uniform(-6, 6, K)
            limb.accept(command(wanted, effort=random.uniform(-500, 500, K), sequence=cycle), now)
        elif event == "silent":
            limb.timed_out()
            engaged_before[:] = False
        elif event == "back":
            if limb.fault.any():  # it was limp
                joint = before = np.clip(joint + random.uniform(-0.5, 0.5, K), LOWER, UPPER)
            report(limb, joint)
        sent, engaged = limb.setpoints(now), limb._engaged
        if sent is None:
            engaged_before = engaged.copy()
            continue
        assert (sent.position >= LOWER - 1e-9).all() and (sent.position <= UPPER + 1e-9).all()
        assert (np.abs(sent.effort) <= EFFORT).all() and (np.abs(sent.velocity) <= SPEED).all()
        moved = np.abs(sent.position - before)
        moves, starts = engaged & engaged_before, engaged & ~engaged_before
        assert (moved[moves] <= step[moves] + 1e-9).all(), "an engaged joint keeps its speed limit"
        assert (np.abs(sent.position - joint)[starts] <= ENGAGE + step[starts]).all(), "it starts near the joint"
        assert (moved[~engaged] < 1e-9).all(), "a joint that is not engaged holds"
        before, engaged_before = sent.position.copy(), engaged.copy()
        joint = np.where(engaged, sent.position, joint)
        if not limb.fault.any():
            report(limb, joint)


def test_without_commands_it_holds_and_the_next_must_start_near() -> None:
    limb = make()
    limb.accept(command(HOME, velocity=np.full(K, 0.5), sequence=1), 0.0)
    limb.setpoints(0.0)
    assert limb.engaged
    sent = limb.setpoints(SILENCE + PERIOD)
    assert sent is not None and not limb.engaged and sent.position == pytest.approx(HOME) and not sent.velocity.any()
    assert limb.setpoints(SILENCE + 2 * PERIOD) is None
    limb.accept(command(HOME + 2 * ENGAGE, sequence=2), 1.0)
    sent = limb.setpoints(1.0)
    assert sent is not None and sent.position == pytest.approx(HOME)


@pytest.mark.parametrize("absent", [np.ones(K, bool), np.arange(K) == 3], ids=["limb", "module"])
def test_joints_that_are_back_start_from_their_position(absent: np.ndarray) -> None:
    limb = make()
    limb.accept(command(HOME), 0.0)
    limb.setpoints(0.0)
    if absent.all():
        limb.timed_out()
    else:
        report(limb, HOME, absent * np.uint8(Fault.NO_ANSWER))
    assert ((limb.fault & Fault.NO_ANSWER > 0) == absent).all()
    sunk = np.where(absent, HOME + 0.5, HOME)
    report(limb, sunk)
    limb.accept(command(HOME, sequence=2), 0.02)
    sent = limb.setpoints(0.02)
    assert sent is not None and sent.position == pytest.approx(sunk), "it is not pulled back"


def test_an_encoder_jump_is_a_fault_until_the_old_position_returns() -> None:
    limb = make()
    limb.accept(command(HOME, sequence=1), 0.0)
    limb.setpoints(0.0)
    report(limb, np.where(np.arange(K) == 2, HOME + 2 * JUMP, HOME))
    assert limb.fault[2] & Fault.ENCODER and limb.position == pytest.approx(HOME)
    limb.accept(command(HOME + 0.01, sequence=2), 0.01)
    sent = limb.setpoints(0.01)
    assert sent is not None and sent.position[2] == pytest.approx(HOME[2]) and sent.position[3] > HOME[3]
    report(limb, HOME)
    assert not limb.fault.any()
    limb.setpoints(0.02)
    assert limb.engaged
