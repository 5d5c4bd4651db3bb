"""The DCM's natural frequency that varies with the CoM's planned height: the equations that it promises to solve."""

from itertools import accumulate
from math import ceil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valor.control.kinematics import natural_frequency
from valor.whole_body.walking.dcm_plan import DcmPlan
from valor.whole_body.walking.frequency import GRID, STEEPEST, NaturalFrequency, VaryingFrequency

GRAVITY, HEIGHT = 9.81, 0.86
OMEGA = natural_frequency(HEIGHT, GRAVITY)
DT = 1e-5  # of numerical differentiation [s]

across = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
paths = st.lists(st.tuples(st.floats(0.2, 1.2), across), min_size=4, max_size=7)
rises = st.lists(st.floats(-0.15, 0.15), min_size=7, max_size=7)
START = np.array((0.05, -0.02, HEIGHT))  # DCM [m]


def knots(path: list[tuple[float, tuple[float, float]]], ground: list[float]) -> np.ndarray:
    return np.array([(0.0, 0.0, HEIGHT), *((*xy, HEIGHT + z) for (_, xy), z in zip(path, ground, strict=True))])


@given(paths)
def test_with_a_constant_height_it_is_constant_and_so_is_the_plan(
    path: list[tuple[float, tuple[float, float]]],
) -> None:
    durations, over = [duration for duration, _ in path], knots(path, [0.0] * len(path))
    end = sum(durations)
    frequency = VaryingFrequency(
        GRAVITY, np.cumsum((0.0, *durations)), np.zeros(len(over)), [(0.5 * end, HEIGHT), (end, HEIGHT)], (HEIGHT, 0, 0)
    )
    varying, constant = (DcmPlan(each, durations, over, START) for each in (frequency, NaturalFrequency(OMEGA)))
    for time in np.linspace(0.0, end, 15):
        np.testing.assert_allclose(varying.at(time), constant.at(time), atol=1e-9)
        assert (varying.omega, varying.omega_dot) == pytest.approx((OMEGA, 0.0), abs=1e-9)
    varying, constant = (DcmPlan(each, durations, over, START) for each in (frequency, NaturalFrequency(OMEGA)))
    for plan in (varying, constant):
        plan.hold(1)
    late = durations[0] + durations[1] + 0.2
    np.testing.assert_allclose(varying.at(late), constant.at(late), atol=1e-9)


@given(paths, rises, st.tuples(st.floats(-0.05, 0.05), st.floats(-0.2, 0.2), st.floats(-0.5, 0.5)))
def test_a_plan_over_any_ground_obeys_the_dynamics(
    path: list[tuple[float, tuple[float, float]]], rise: list[float], begin: tuple[float, float, float]
) -> None:
    """ξ̇ = (ω − ω̇/ω)·(ξ − v) in all axes, and the force on the CoM passes the CoP: v is g/(ω² − ω̇) above it."""
    durations, ground = [duration for duration, _ in path], [0.0, *accumulate(rise[: len(path)])]
    times, over = [0.0, *accumulate(durations)], knots(path, ground[1:])
    points = [(times[2], HEIGHT + ground[2] - 0.02), (times[-1], HEIGHT + ground[-1])]
    frequency = VaryingFrequency(GRAVITY, np.array(times), np.array(ground), points, (HEIGHT + begin[0], *begin[1:]))
    plan = DcmPlan(frequency, durations, over, START)
    np.testing.assert_allclose(plan.at(0.0)[0][:2], START[:2], atol=1e-9)
    count = ceil(times[-1] / GRID)
    for time in times[-1] * (np.arange(count) + 0.5) / count:  # the middles of the intervals: where λ is exact
        (before, _), (dcm, vrp) = plan.at(time - DT), plan.at(time)
        omega, omega_dot = plan.omega, plan.omega_dot
        after, _ = plan.at(time + DT)
        np.testing.assert_allclose((after - before) / (2 * DT), (omega - omega_dot / omega) * (dcm - vrp), atol=0.02)
        stiffness = omega**2 - omega_dot
        if 1.001 < STEEPEST * stiffness / OMEGA**2 < 0.999 * STEEPEST**2:  # not clipped
            cop = np.interp(time, times, ground)
            assert vrp[2] == pytest.approx(cop + GRAVITY / stiffness, abs=1e-6)
    np.testing.assert_allclose(plan.at(times[-1])[0], over[-1], atol=1e-9)


def test_a_com_that_follows_passes_the_heights_without_a_jump_of_the_force() -> None:
    """Up a flight of stairs; the CoM's rate is ω·(ξ − c)."""
    times, ground = np.array((0.0, 0.4, 1.4, 1.8, 2.8, 3.2, 4.2)), np.array((0.0, 0.0, 0.0, 0.15, 0.15, 0.3, 0.3))
    points = [(1.6, HEIGHT + 0.04), (3.0, HEIGHT + 0.2), (4.2, HEIGHT + 0.3)]
    over = np.column_stack((np.zeros((7, 2)), HEIGHT + ground))
    frequency = VaryingFrequency(GRAVITY, times, ground, points, (HEIGHT, 0.0, 0.0))
    plan = DcmPlan(frequency, np.diff(times).tolist(), over, np.array((0.0, 0.0, HEIGHT)))
    height, dt, heights, forces = HEIGHT, 1e-3, [], []
    for i in range(4200):
        dcm, vrp = plan.at((i + 0.5) * dt)
        heights.append(height)
        forces.append((plan.omega**2 - plan.omega_dot) * (height - vrp[2]))
        height += plan.omega * (dcm[2] - height) * dt
    for time, expected in points[:2]:
        assert heights[round(time / dt)] == pytest.approx(expected, abs=2e-3)
    assert heights[-1] == pytest.approx(HEIGHT + 0.3, abs=2e-3)
    assert np.abs(np.diff(forces)).max() < 0.02 and np.abs(forces).max() < 1.0  # [m/s²]
