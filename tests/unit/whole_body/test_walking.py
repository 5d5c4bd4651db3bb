"""The DCM's plan, swinging feet and steps on line: mathematics against numerical integration and limits."""

from math import cos
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.common import rotation
from valor.control.steps import SolePose, Step
from valor.robot.description import RobotDescription
from valor.robot.footsteps import StepRule
from valor.whole_body.walking.dcm_plan import DcmPlan
from valor.whole_body.walking.footsteps import level_pose
from valor.whole_body.walking.frequency import NaturalFrequency
from valor.whole_body.walking.swing import SwingPoint, SwingTrajectory
from valor.whole_body.walking.velocity_steps import VelocitySteps

OMEGA = 3.377
FREQUENCY = NaturalFrequency(OMEGA)
DT = 1e-4  # of numerical integration and differentiation [s]
FEET = [level_pose(0.0, 0.1, 0.0, 0.0), level_pose(0.0, -0.1, 0.0, 0.0)]

places = st.floats(-0.5, 0.5)
points = st.tuples(places, places, places)


@given(st.lists(st.tuples(st.floats(0.1, 1.5), points), min_size=2, max_size=8), points, points)
def test_a_plan_begins_where_it_must_and_obeys_the_dynamics(
    pieces: list[tuple[float, tuple[float, float, float]]],
    start: tuple[float, float, float],
    dcm: tuple[float, float, float],
) -> None:
    knots = np.array([start, *(point for _, point in pieces)])
    plan = DcmPlan(FREQUENCY, [duration for duration, _ in pieces], knots, np.array(dcm))
    first, vrp = plan.at(0.0)
    np.testing.assert_allclose(first, dcm, atol=1e-9)
    np.testing.assert_allclose(vrp, start, atol=1e-9)
    moved = np.delete(plan.knots, 1, axis=0)
    np.testing.assert_array_equal(moved, np.delete(knots, 1, axis=0))  # only the first knot gave way
    size = 1.0 + np.abs(plan.knots).max()
    before, time = first, 0.0
    for _ in range(200):  # ξ̇ = ω·(ξ − v), by central differences
        time += plan.duration / 200
        after, _ = plan.at(time)
        middle = DcmPlan(FREQUENCY, [duration for duration, _ in pieces], knots, np.array(dcm)).at(time - DT)[0]
        _, vrp = plan.at(time)
        np.testing.assert_allclose((after - middle) / DT, OMEGA * (after - vrp), atol=0.01 * size)
        before = after
    np.testing.assert_allclose(before, knots[-1], atol=1e-9 * size)
    rest, vrp = plan.at(plan.duration + 10.0)
    np.testing.assert_allclose(rest, knots[-1], atol=1e-9 * size)
    np.testing.assert_allclose(vrp, knots[-1], atol=1e-9 * size)


@given(points, points, st.floats(0.0, 0.3))
def test_a_plan_gives_way_no_further_than_it_may(
    start: tuple[float, float, float], dcm: tuple[float, float, float], most: float
) -> None:
    knots, giving = np.array([start, (0.0, 0.1, 0.9), (0.0, 0.1, 0.9), (0.1, 0.0, 0.9)]), slice(1, 3)
    plan = DcmPlan(FREQUENCY, [0.1, 0.5, 1.0], knots, np.array(dcm), giving, most=most)
    moved = plan.knots - knots
    np.testing.assert_array_equal(moved[[0, 3]], 0.0)
    assert np.hypot(*moved[1, :2]) <= most + 1e-12
    free = DcmPlan(FREQUENCY, [0.1, 0.5, 1.0], knots, np.array(dcm), giving)
    if np.hypot(*(free.knots - knots)[1, :2]) <= most:
        np.testing.assert_array_equal(plan.knots, free.knots)


def test_a_plan_on_hold_lets_the_dcm_go_on_from_where_the_vrp_rests() -> None:
    knots = np.array([[0, 0.1, 0.9], [0, -0.1, 0.9], [0, -0.1, 0.9], [0.3, 0.1, 0.9], [0.3, 0.0, 0.9]])
    plan = DcmPlan(FREQUENCY, [0.2, 0.6, 0.2, 1.0], knots, np.array([0.05, 0.0, 0.9]))
    plan.hold(1)
    dcm, vrp = plan.at(0.8)
    for time in np.arange(0.8, 1.0, DT):  # the next piece would have begun
        dcm = vrp + (dcm - vrp) * np.exp(OMEGA * DT)
        after, held = plan.at(time + DT)
        np.testing.assert_allclose(after, dcm, atol=1e-9)
        np.testing.assert_allclose(held, knots[2], atol=1e-12)


def swing_to(height: float, **changes: float) -> SwingTrajectory:
    """A swing of the left foot to a place so high [m], with a turn."""
    target = SolePose(np.array([0.4, 0.12, height]), rotation.yaw_matrix(0.3))
    values: dict[str, Any] = {"height": 0.06, "duration": 0.6, "depth": 0.003, "descent": 0.05} | changes
    return SwingTrajectory(FEET[0], target, **values)


def test_a_swing_leaves_at_rest_and_comes_down_over_its_apex() -> None:
    swing = swing_to(0.05)
    begin, middle, end = swing.at(0.0), swing.at(0.3), swing.at(0.6 - 1e-9)
    np.testing.assert_allclose(begin.position, FEET[0].position)
    np.testing.assert_allclose(end.position, [0.4, 0.12, 0.047], atol=1e-6)
    np.testing.assert_allclose(end.rotation, rotation.yaw_matrix(0.3), atol=1e-6)
    assert middle.position[2] == pytest.approx(0.05 + 0.06)
    np.testing.assert_allclose(begin.velocity, 0.0, atol=1e-6)
    np.testing.assert_allclose(end.velocity, [0.0, 0.0, -0.05, 0.0, 0.0, 0.0], atol=1e-6)
    late = swing.at(0.8)
    assert late.position[2] == pytest.approx(0.047 - 0.2 * 0.05) and late.velocity[2] == pytest.approx(-0.05)


def test_a_late_foot_comes_down_quicker_and_goes_along() -> None:
    swing = swing_to(0.05, descent=0.2, late_descent=0.4)
    before = swing.at(0.62)
    swing.follow(0.62, np.array([0.45, 0.2, 0.0]))
    np.testing.assert_allclose(swing.at(0.62).position, before.position, atol=1e-12)
    for time in (0.61, 0.64, 0.66, 0.7, 0.9):  # derivatives, within each of its pieces
        earlier, here, later = swing.at(time - DT), swing.at(time), swing.at(time + DT)
        np.testing.assert_allclose((later.position - earlier.position) / (2 * DT), here.velocity[:3], atol=1e-3)
        np.testing.assert_allclose((later.velocity - earlier.velocity) / (2 * DT), here.acceleration, atol=5e-2)
    there = swing.at(0.7)
    np.testing.assert_allclose(there.position[:2], (0.45, 0.2))
    assert there.velocity[2] == pytest.approx(-0.4)
    np.testing.assert_allclose(there.rotation, before.rotation, atol=1e-9)


def climbing() -> SwingTrajectory:
    """A swing up a step of 12 cm: it peels off, turned by 0.48 rad at most."""
    return swing_to(0.12, toe=0.15)


def toe_of(point: SwingPoint) -> np.ndarray:
    """(3,) of a sole in odom [m]."""
    toe: np.ndarray = point.position + point.rotation @ np.array((0.15, 0.0, 0.0))
    return toe


def test_a_foot_that_goes_up_peels_off_over_its_toe() -> None:
    swing, flat = climbing(), swing_to(0.12)
    for time in np.linspace(0.0, 0.7, 36):
        here, there = swing.at(time), flat.at(time)
        assert here.rotation[2, 0] <= 1e-9  # toes never up
        assert toe_of(here)[2] == pytest.approx(toe_of(there)[2], abs=1e-3)
    assert swing.at(0.18).rotation[2, 2] == pytest.approx(cos(0.48), abs=1e-6)
    np.testing.assert_allclose(swing.at(0.5).rotation[2], (0.0, 0.0, 1.0), atol=1e-6)
    before = swing.at(0.1)
    assert before.position[:2] == pytest.approx(FEET[0].position[:2])  # up before forward


@given(st.floats(0.01, 0.44), st.floats(0.1, 0.5))
def test_a_peeling_swing_has_its_derivatives_and_is_retargeted_without_a_jump(time: float, left: float) -> None:
    swing = climbing()
    joints = (0.12, 0.18, 0.3)  # where polynomials meet
    if all(abs(time - joint) > 2 * DT for joint in joints):
        before, here, after = swing.at(time - DT), swing.at(time), swing.at(time + DT)
        np.testing.assert_allclose((after.position - before.position) / (2 * DT), here.velocity[:3], atol=1e-4)
        np.testing.assert_allclose((after.velocity - before.velocity) / (2 * DT), here.acceleration, atol=2e-2)
        turned = rotation.rotation_vector(after.rotation @ before.rotation.T) / (2 * DT)
        np.testing.assert_allclose(turned, here.velocity[3:], atol=1e-4)
    before = swing.at(time)
    swing.retarget(time, level_pose(0.45, 0.1, 0.12, 0.3), time + left)
    after = swing.at(time)
    np.testing.assert_allclose(after.position, before.position, atol=1e-9)
    np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-9)
    np.testing.assert_allclose(after.velocity, before.velocity, atol=1e-9)
    np.testing.assert_allclose(after.acceleration, before.acceleration, atol=1e-7)
    np.testing.assert_allclose(swing.at(time + left).rotation, rotation.yaw_matrix(0.3), atol=1e-6)


@given(
    st.floats(0.0, 0.55), st.floats(0.05, 0.5), places, places, st.floats(-0.5, 0.5), st.floats(0.0, 0.1)
)  # fmt: skip
def test_a_retargeted_swing_does_not_jump(time: float, left: float, x: float, y: float, yaw: float, z: float) -> None:
    swing = swing_to(0.0)
    for _ in range(2):  # the second one begins from a swing that is none from rest
        before = swing.at(time)
        swing.retarget(time, level_pose(x, y, z, yaw), time + left)
        after = swing.at(time)
        np.testing.assert_allclose(after.position, before.position, atol=1e-9)
        np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-9)
        np.testing.assert_allclose(after.velocity, before.velocity, atol=1e-9)
        np.testing.assert_allclose(after.acceleration, before.acceleration, atol=1e-7)
        end = swing.at(time + left - 1e-9)
        np.testing.assert_allclose(end.position, [x, y, z - 0.003], atol=1e-6)
        np.testing.assert_allclose(end.rotation, rotation.yaw_matrix(yaw), atol=1e-6)
        np.testing.assert_allclose(end.velocity, [0.0, 0.0, -0.05, 0.0, 0.0, 0.0], atol=1e-4)
        time, left, x = time + 0.4 * left, 0.5 * left, x - 0.1


def follow(source: VelocitySteps, command: tuple[float, float, float], count: int) -> list[Step]:
    """Steps taken as planned, with the command repeated before each."""
    soles, taken = list(FEET), []
    for i in range(count):
        source.command(np.array(command), float(i))
        steps = source.upcoming(soles)
        if not steps:
            break
        source.began(steps[0])
        soles[steps[0].foot] = steps[0].sole
        source.ended(steps[0])
        taken.append(steps[0])
    return taken


velocities = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))


@given(velocities)
def test_steps_on_line_are_within_reach_and_alternate(command: tuple[float, float, float]) -> None:
    from harness.closed_loop import load_robot

    tables = load_robot().tables
    assert tables.footsteps is not None
    soles = list(FEET)
    last = None
    for step in follow(VelocitySteps(tables.walking), command, 10):
        assert step.foot != last and not StepRule(tables.footsteps, tables.feet).reach(step, soles[1 - step.foot])
        soles[step.foot], last = step.sole, step.foot


@pytest.mark.parametrize("command", [(0.4, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.0, 0.08, 0.0), (0.0, -0.4, 0.0)])
def test_steps_on_line_go_at_the_velocity(robot: RobotDescription, command: tuple[float, float, float]) -> None:
    taken = follow(VelocitySteps(robot.tables.walking), command, 20)
    way = taken[-1].sole.position - taken[-11].sole.position  # ten steps, of the same foot
    duration = sum(step.swing_duration + step.transfer_duration for step in taken[-10:])
    np.testing.assert_allclose(way[:2] / duration, command[:2], atol=1e-9)
