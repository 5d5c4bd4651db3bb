"""Where and when a step comes down when the DCM is not where it was planned to be."""

from dataclasses import replace
from math import cos, exp, inf, nan, sin

import casadi as ca
import msgspec
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from harness.closed_loop import load_robot
from valor.control.steps import Step
from valor.control.tuning_tables import Tuning
from valor.robot.footsteps import LEFT, StepRule
from valor.whole_body.walking.footsteps import level_pose
from valor.whole_body.walking.step_guard import PEAK, Adjustment, Situation, StepAdjuster, StepGuard

OMEGA = 3.377
TRANSFER = 0.2
ROBOT = load_robot()
ADJUSTER = StepAdjuster(ROBOT)
CENTRE = np.array((0.025, 0.0, 0.87))  # over the stance sole


def situation(
    foot: int,
    place: tuple[float, float],
    error: tuple[float, float],
    left: float,
    *,
    heading: float = 0.0,
    adjustable: float = inf,
    least: float = 0.06,
) -> Situation:
    """A step to ``place`` (forward, outward) of a stance foot that stands somewhere, turned by ``heading``."""
    c, s = cos(heading), sin(heading)
    side = 1.0 if foot == LEFT else -1.0

    def placed(x: float, y: float) -> np.ndarray:
        return np.array((3.0 + c * x - s * y, -2.0 + s * x + c * y, 0.0))

    x, y = place[0], side * place[1]
    target, behind = placed(x, y), placed(x - 0.1, y)
    # The DCM that walking on the spot from there would have at touchdown: between the feet.
    landing = placed(CENTRE[0] + 0.5 * x, 0.55 * y) + np.array((0.0, 0.0, CENTRE[2]))
    return Situation(
        step=Step(0, foot, level_pose(target[0], target[1], 0.0, heading), 0.06, 0.6, TRANSFER, adjustable),
        stance=level_pose(3.0, -2.0, 0.0, heading), swing=level_pose(behind[0], behind[1], 0.05, heading),
        centre=placed(CENTRE[0], CENTRE[1]) + np.array((0.0, 0.0, CENTRE[2])),
        dcm_error=np.array((c * error[0] - s * error[1], s * error[0] + c * error[1], 0.0)), landing_dcm=landing,
        left=left, least=least, transfer=TRANSFER, omega=OMEGA,
    )  # fmt: skip


def begin(guard: StepGuard, case: Situation) -> None:
    guard.begin(
        case.step, case.stance, case.centre,
        landing_dcm=case.landing_dcm, touchdown=0.6, transfer=TRANSFER, omega=OMEGA,
    )  # fmt: skip


feet = st.sampled_from((0, 1))
headings = st.floats(-3.1, 3.1)
left_times = st.floats(0.07, 0.8)
errors = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))


def adjust(given: Situation) -> Adjustment:
    found = ADJUSTER.adjust(given)
    assert found is not None
    return found


@given(feet, headings, left_times)
def test_without_an_error_nothing_changes(foot: int, heading: float, left: float) -> None:
    asked = situation(foot, (0.15, 0.2), (0.0, 0.0), left, heading=heading)
    found = adjust(asked)
    np.testing.assert_allclose(found.foothold, asked.step.sole.position, atol=1e-6)
    np.testing.assert_allclose(found.landing_dcm, asked.landing_dcm, atol=1e-6)
    assert found.left == pytest.approx(left, abs=1e-6) and found.cost == pytest.approx(0.0, abs=1e-6)


@example(0, -0.296875, 0.25, (-1.0, 0.0), 0.0, 0.0703125)  # a foot beyond reach with no time left
@given(feet, st.floats(-0.3, 0.5), st.floats(0.15, 0.4), errors, headings, left_times)
def test_whatever_the_error_the_step_is_within_reach(
    foot: int, x: float, y: float, error: tuple[float, float], heading: float, left: float
) -> None:
    limits, table = ROBOT.tables.footsteps, ROBOT.read(Tuning).disturbance
    assert limits is not None
    asked = situation(foot, (x, y), error, left, heading=heading)
    found = adjust(asked)
    sole = level_pose(found.foothold[0], found.foothold[1], found.foothold[2], heading)
    step = Step(0, foot, sole, 0.06, 0.6, TRANSFER)
    slack = 1e-5 * (1.0 + max(map(abs, error)))  # the solver's, of a problem with such numbers
    wider = msgspec.structs.replace(
        limits, min_width=limits.min_width - slack, max_width=table.max_width + slack,
        max_forward=limits.max_forward + slack, max_backward=max(limits.max_backward, table.max_backward) + slack,
    )  # fmt: skip
    assert not StepRule(wider, ROBOT.tables.feet).reach(step, asked.stance)
    assert min(left, table.final) - 1e-6 <= found.left <= left + table.longest_delay + 1e-6
    assert np.isfinite(found.landing_dcm).all()


@given(feet, st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)), headings, st.floats(0.15, 0.4))
def test_a_foot_goes_no_farther_than_it_can_until_the_adjusted_touchdown(
    foot: int, error: tuple[float, float], heading: float, left: float
) -> None:
    asked = situation(foot, (0.1, 0.25), error, left, heading=heading)
    found = adjust(asked)
    c, s = cos(heading), sin(heading)
    way = (found.foothold - asked.swing.position)[:2] @ np.array(((c, -s), (s, c)))
    pace = ROBOT.read(Tuning).disturbance.foot_speed / PEAK
    assert np.abs(way).max() <= pace * (left + (exp(OMEGA * (found.left - left)) - 1.0) / OMEGA) + 1e-5


@given(feet, st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)), left_times, st.floats(0.01, 0.1))
def test_a_plans_step_moves_no_further_than_it_may(
    foot: int, error: tuple[float, float], left: float, bound: float
) -> None:
    asked = situation(foot, (0.15, 0.2), error, left, adjustable=bound)
    moved = adjust(asked).foothold - asked.step.sole.position
    assert np.abs(moved).max() <= bound + 1e-5


@pytest.mark.parametrize("foot", [0, 1])
def test_a_step_costs_what_the_next_one_cannot_mend(foot: int) -> None:
    """An error outwards is mended by a wide step, one inwards by that of the other foot."""
    side = 1.0 if foot == LEFT else -1.0

    def costs(error: float) -> tuple[float, float]:
        first = situation(foot, (0.0, 0.2), (0.0, side * error), 0.32, least=0.27)
        second = situation(1 - foot, (0.0, 0.2), (0.0, 0.0), 0.3, least=0.25)
        moved = first.step.sole.position - first.stance.position
        second = replace(
            second, step=replace(second.step, sole=first.stance), stance=first.step.sole, swing=first.stance,
            centre=second.centre + moved, landing_dcm=second.landing_dcm + moved,
        )  # fmt: skip
        return adjust(first).cost, ADJUSTER.cost_of_two(first, second)

    alone, both = costs(-0.07)
    assert both < 0.3 * alone
    alone, both = costs(-0.1)
    assert both > 0.8 * alone  # too much for the other foot, too
    alone, both = costs(0.05)
    assert both == pytest.approx(alone, rel=0.1)


def test_numbers_that_are_not_finite_change_nothing() -> None:
    assert ADJUSTER.adjust(situation(LEFT, (0.1, 0.2), (nan, 0.0), 0.3)) is None
    assert ADJUSTER.adjust(situation(LEFT, (0.1, 0.2), (0.0, inf), 0.3)) is None


@pytest.mark.parametrize("foot", [0, 1])
def test_a_push_forward_is_a_longer_step_and_one_inwards_a_sooner_one(foot: int) -> None:
    side = 1.0 if foot == LEFT else -1.0
    planned = situation(foot, (0.15, 0.2), (0.0, 0.0), 0.4)
    forward = adjust(situation(foot, (0.15, 0.2), (0.1, 0.0), 0.4))
    assert forward.foothold[0] > planned.step.sole.position[0] + 0.05
    outward = adjust(situation(foot, (0.15, 0.2), (0.0, side * 0.05), 0.4))
    assert side * (outward.foothold[1] - planned.step.sole.position[1]) > 0.02
    inward = adjust(situation(foot, (0.15, 0.2), (0.0, -side * 0.12), 0.4))  # beyond the stance foot
    assert inward.left < 0.35


def test_it_is_the_optimum_of_the_problem_in_times_and_places() -> None:
    """IPOPT on the problem as one would write it down, in T and in the CoP."""
    table, inset = ROBOT.read(Tuning).disturbance, ROBOT.read(Tuning).whole_body.contact_inset
    tables = ROBOT.tables
    lx = table.cop_share * (
        0.5 * (tables.feet.left.toe - tables.feet.left.heel) - ROBOT.read(Tuning).whole_body.contact_inset
    )
    ly = table.cop_share * (tables.feet.left.half_width - inset)
    for error in ((0.05, 0.0), (-0.06, 0.02), (0.02, 0.05), (0.03, -0.03)):
        asked = situation(LEFT, (0.15, 0.2), error, 0.4)
        found = adjust(asked)
        opti = ca.Opti()
        place, time, cop = opti.variable(2), opti.variable(), opti.variable(2)
        planned = asked.step.sole.position[:2] - asked.stance.position[:2]
        centre = asked.centre[:2] - asked.stance.position[:2]
        landing = asked.landing_dcm[:2] - asked.stance.position[:2]
        growth, decay = exp(OMEGA * asked.left), exp(-OMEGA * TRANSFER)
        alpha = (1.0 - decay) / (OMEGA * TRANSFER)
        now = centre + (landing + np.array(error) * growth - centre) / growth
        reached = centre + cop + (now - centre - cop) * ca.exp(OMEGA * time)
        offset = (reached - landing - alpha * (place - planned)) / decay
        shift = cop * (1.0 - ca.exp(OMEGA * time)) / (growth - 1.0)
        ratio = ca.exp(OMEGA * (time - asked.left))
        opti.minimize(
            table.foothold_weight * ca.sumsqr(place - planned)
            + table.time_weight * ((ratio - 1.0) / OMEGA) ** 2
            + table.offset_weight * ca.sumsqr(offset)
            + table.cop_weight * ca.sumsqr(shift)
        )
        opti.subject_to(opti.bounded(-np.array((lx, ly)), cop, np.array((lx, ly))))
        opti.subject_to(time >= asked.least)
        opti.set_initial(place, planned)
        opti.set_initial(time, asked.left)
        opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "tol": 1e-10})
        solution = opti.solve()
        np.testing.assert_allclose(
            found.foothold[:2] - asked.stance.position[:2], solution.value(place), atol=2e-4, err_msg=str(error)
        )
        assert found.left == pytest.approx(float(solution.value(time)), abs=2e-4)


@given(feet, headings, st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.sampled_from((0.0, 0.05, inf)))
def test_a_late_foot_goes_where_the_dcm_needs_it_within_reach(
    foot: int, heading: float, x: float, y: float, adjustable: float
) -> None:
    case = situation(foot, (0.3, 0.2), (0.0, 0.0), 0.06, heading=heading, adjustable=adjustable)
    assert ROBOT.tables.footsteps is not None
    guard = StepGuard(ROBOT)
    begin(guard, case)
    moved = np.array((x, y, 0.0))
    place = guard.late_foothold(case.landing_dcm + moved)
    x, y, _ = (place - case.step.sole.position).tolist()
    c, s = cos(heading), sin(heading)
    assert max(abs(c * x + s * y), abs(c * y - s * x)) <= adjustable + 1e-9
    moved_step = replace(case.step, sole=replace(case.step.sole, position=place))
    assert not StepRule(ROBOT.tables.footsteps, ROBOT.tables.feet).reach(moved_step, case.stance)
    gain = (1.0 - exp(-OMEGA * TRANSFER)) / (OMEGA * TRANSFER)
    if adjustable == inf and np.hypot(x, y) < 0.02:  # nothing in the way
        np.testing.assert_allclose(place - case.step.sole.position, moved / gain, atol=1e-9)


@given(feet, headings, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_the_vrp_of_a_late_step_stays_over_the_stance_sole_and_holds_the_dcm_back(
    foot: int, heading: float, x: float, y: float
) -> None:
    case = situation(foot, (0.3, 0.2), (0.0, 0.0), 0.06, heading=heading)
    guard = StepGuard(ROBOT)
    begin(guard, case)
    c, s = cos(heading), sin(heading)
    dcm = case.centre + np.array((c * x - s * y, s * x + c * y, 0.0))
    dx, dy, dz = (guard.late_vrp(dcm) - case.centre).tolist()
    forward, left = c * dx + s * dy, c * dy - s * dx
    sole = ROBOT.tables.feet.left
    assert abs(forward) < 0.5 * (sole.toe - sole.heel) and abs(left) < sole.half_width
    assert dz == 0.0
    assert abs(x - forward) <= abs(x) + 1e-12
    assert abs(y - left) <= abs(y) + 1e-12


def test_a_late_foot_stays_where_it_was_led_when_the_dcm_is_no_number() -> None:
    case = situation(LEFT, (0.3, 0.2), (0.0, 0.0), 0.06)
    guard = StepGuard(ROBOT)
    begin(guard, case)
    np.testing.assert_array_equal(guard.late_foothold(np.full(3, nan)), case.step.sole.position)
