"""What is commanded goes together, whatever streams: position, velocity, and the acceleration that is fed forward."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.closed_loop import load_robot
from harness.examples import examples
from tests.unit.test_hand_reach import MODEL, UNMOVED, Arms
from valor.common.arrays import FloatArray
from valor.control.kinematics import ModelJoints
from valor.motion_manager.hands.goal_stream import HandGoal
from valor.motion_manager.joints.joint_reference import MISMATCH, MISMATCH_TIME, JointReference, Setpoint
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.limiter import Joints
from valor.robot.motion_tables import Walking
from valor.whole_body.balance.pelvis import PelvisReference
from valor.whole_body.walking.velocity_steps import VelocitySteps

ROBOT = load_robot()
DT = ROBOT.control_period
LIMBS = ["left_arm", "left_hand", "torso", "neck"]
RATES = st.floats(1.0, 1000.0)


def due(rate: float, jitter: float, lost: float, seed: int, periods: int) -> list[bool]:
    """Whether something comes, for each control period."""
    random, at, out = np.random.default_rng(seed), 0.0, list[bool]()
    for i in range(periods):
        out.append(at <= i * DT and random.random() >= lost)
        while at <= i * DT:
            at += (1.0 + jitter * random.uniform(-1.0, 1.0)) / rate
    return out


class Checked:
    """Position, velocity and acceleration of successive periods."""

    def __init__(self, position: FloatArray, limits: CommandedLimits) -> None:
        self.position, self.velocity, self._limits = position, np.zeros_like(position), limits
        self._surplus = np.zeros_like(position)

    def period(
        self, position: FloatArray, velocity: FloatArray, fed: FloatArray | None = None, dropped: Joints | None = None
    ) -> None:
        limits, change = self._limits, velocity - self.velocity
        np.testing.assert_allclose(position - self.position, velocity * DT, atol=1e-9)
        assert (np.abs(velocity) <= limits.fastest + 1e-9).all()
        braking = np.abs(velocity) < np.abs(self.velocity)  # at a limit
        assert ((np.abs(change) <= limits.acceleration * DT + 1e-9) | braking).all()
        if fed is not None and dropped is not None:
            surplus = np.where(dropped, 0.0, fed * DT - change)
            self._surplus = (1.0 - DT / MISMATCH_TIME) * self._surplus + surplus
            assert (self._surplus * np.sign(fed) < MISMATCH + 1e-6).all(), np.abs(self._surplus).max()
        self.position, self.velocity = position.copy(), velocity.copy()


@pytest.mark.parametrize("limb", LIMBS)
@examples(12)
@given(
    rate=RATES, jitter=st.floats(0.0, 0.9), lost=st.floats(0.0, 0.5), seed=st.integers(0, 999),
    amplitude=st.floats(0.0, 1.0), turns=st.floats(0.1, 3.0), lies=st.floats(0.0, 5.0),
)  # fmt: skip
def test_joints(
    limb: str, rate: float, jitter: float, lost: float, seed: int, amplitude: float, turns: float, lies: float
) -> None:
    """Accelerations are those of the positions, and others that change their sign ``lies`` times a second."""
    joints, reference = ROBOT.group_indices(limb), JointReference(ROBOT)
    reference.take_up(np.ones(len(ROBOT.joints), dtype=bool), ROBOT.nominal_posture)
    limits = reference.limits.select(joints)
    home, checked = ROBOT.nominal_posture[joints], Checked(reference.position, reference.limits)
    turn, random = 2.0 * np.pi * turns, np.random.default_rng(seed)
    untrue = limits.acceleration * random.uniform(-1.0, 1.0) * (lies > 0.5)
    for i, comes in enumerate(due(rate, jitter, lost, seed, 500)):
        now = i * DT
        if comes:
            angle, sign = turn * now, 1.0 if int(2.0 * lies * now) % 2 else -1.0
            position = home + amplitude * (1.0 - np.cos(angle))
            velocity = np.full(len(joints), amplitude * turn * np.sin(angle))
            acceleration = amplitude * turn**2 * np.cos(angle) + sign * untrue
            reference.follow(
                Setpoint(
                    joints, limits.position_within(position), limits.velocity_within(velocity),
                    limits.acceleration_within(acceleration), now,
                )
            )  # fmt: skip
        reference.advance(now, DT)
        checked.period(reference.position, reference.velocity, reference.acceleration, reference.inconsistent)


@examples(8)
@given(rate=RATES, jitter=st.floats(0.0, 0.9), lost=st.floats(0.0, 0.5), seed=st.integers(0, 999),
       radius=st.floats(0.0, 0.2), turns=st.floats(0.1, 2.0))  # fmt: skip
def test_goals_of_a_hand(rate: float, jitter: float, lost: float, seed: int, radius: float, turns: float) -> None:
    arms = Arms()
    checked = Checked(arms.reference.position, arms.reference.limits)
    for i, comes in enumerate(due(rate, jitter, lost, seed, 500)):
        arms.now = i * DT
        angle = 2.0 * np.pi * turns * arms.now
        if comes:
            place = np.array((0.4, 0.3 + radius * np.cos(angle), 0.2 + radius * np.sin(angle)))
            arms.goals.start(0, HandGoal(False, place, np.eye(3)), arms.now)
        arms.goals.advance(UNMOVED, arms.reference.position, arms.now, DT)
        arms.reference.advance(arms.now, DT)
        reference = arms.reference
        checked.period(reference.position, reference.velocity, reference.acceleration, reference.inconsistent)


@examples(8)
@given(rate=RATES, jitter=st.floats(0.0, 0.9), lost=st.floats(0.0, 0.5), seed=st.integers(0, 999))
def test_the_pelvis(rate: float, jitter: float, lost: float, seed: int) -> None:
    """Any poses and velocities, also such as do not go together."""
    places = ModelJoints(MODEL)
    pelvis = PelvisReference(MODEL, np.concatenate([places.group(f"{side}_leg") for side in ("left", "right")]))
    random, limits = np.random.default_rng(seed), pelvis.limits
    checked = Checked(pelvis.position, limits)
    for i, comes in enumerate(due(rate, jitter, lost, seed, 500)):
        if comes:
            position = random.uniform(limits.lower, limits.upper)
            pelvis.lead(position, random.uniform(-limits.velocity, limits.velocity), i * DT)
        pelvis.advance(i * DT, DT)
        checked.period(pelvis.position, pelvis._limiter.velocity)


@examples(8)
@given(rate=RATES, jitter=st.floats(0.0, 0.9), lost=st.floats(0.0, 0.5), seed=st.integers(0, 999))
def test_cmd_vel(rate: float, jitter: float, lost: float, seed: int) -> None:
    """Any velocities: each step's differs by no more than the robot's change of a step, and stays within limits."""
    table: Walking = ROBOT.tables.walking
    steps, random = VelocitySteps(table), np.random.default_rng(seed)
    before, change = np.zeros(3), np.array((table.speed_change, table.speed_change, table.turn_change))
    highest = np.array((table.max_forward_speed, table.max_lateral_speed, table.max_turn_rate))
    for i, comes in enumerate(due(rate, jitter, lost, seed, 2000)):
        if comes:
            steps.command(random.uniform(-3.0, 3.0, 3), i * DT)
        steps.advance(i * DT)
        if i % 350 == 0:
            velocity = steps._changed(before)
            assert (np.abs(velocity - before) <= change + 1e-3).all() and (np.abs(velocity) <= highest + 1e-9).all()
            before = velocity
