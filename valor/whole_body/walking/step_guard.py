"""Step adjustment: foothold and touchdown time of the step under way, from the measured DCM, by a small QP.

A step stays as planned while the DCM error is small. Above a threshold, until shortly before touchdown, foothold and
time follow the DCM every period, as does its reference ξ(t) = c + (ξ_td − c)·e^{ω(t − T)} with the VRP c over the
stance foot. During the transfer of weight only the foothold follows. If the foot is late, the DCM moves on: the CoP
follows it to the edge of the stance sole, which slows it, and the foothold moves by ξ' = ξ_td + α·Δs (below).

Over the time T left to touchdown the stance foot's VRP c repels the DCM: an error e grows to e·e^{ωT}, so that the
planned timing leads to ξ_p = ξ_td + e·e^{ωT}, with ξ_td the planned DCM at touchdown. Other choices give

    ξ' = c + (ξ_p − c)·r + d        r = e^{ωΔT} for touchdown later by ΔT;  |d| ≤ l·(r·e^{ωT} − 1) for CoPs within ± l

The plan continues from a foothold moved by Δs, later steps moved alike, if ξ' = ξ_td + α·Δs. The residual is the
error b of the next swing's first DCM:

    β·b = ξ' − ξ_td − α·Δs          β = e^{−ωT_d},  α = (1 − β)/(ωT_d),  T_d the transfer of weight after the step

This is linear in (s, r, d), with time among the unknowns (Khadiv, Herzog, Moosavian & Righetti 2020, "Walking control
based on step timing adaptation", for point feet; here with the CoP's reach and double support):

    min  w_s·‖Δs‖² + w_t·((r − 1)/ω)² + w_b·‖b‖² + w_d·‖d/(e^{ωT} − 1)‖²   s within reach and the foot's way in T + ΔT

Without an error the plan is the optimum. CasADi evaluates the matrices; DAQP solves the QP.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import cos, exp, hypot, inf, isfinite, log, sin
from typing import Any

import casadi as ca
import daqp
import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.control.steps import SolePose, Step
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.footsteps import LEFT

UNBOUNDED = 1e30  # No bound, for the solver
PEAK = 1.875  # Ratio of peak to mean speed of a minimum-jerk motion
UNKNOWNS = 5  # s (2), r, d (2)
ROWS = 10  # CoP (4), reach along the diagonals (2), way of the foot (4)
PARAMETERS = 14


@dataclass(frozen=True, slots=True)
class Situation:
    """Step under way, as planned and as measured."""

    step: Step  # as planned
    stance: SolePose  # the other foot
    swing: SolePose  # the foot of the step, where it is
    centre: FloatArray  # (3,) c, the VRP over the stance foot [m]
    dcm_error: FloatArray  # (3,) measured less planned DCM [m]
    landing_dcm: FloatArray  # (3,) ξ_td, planned DCM at touchdown [m]
    left: float  # T: until touchdown, as planned [s]
    least: float  # least permitted T [s]
    transfer: float  # T_d: transfer of weight after the step [s]
    omega: float  # ω [1/s]


@dataclass(frozen=True, slots=True)
class Adjustment:
    """Adjusted step."""

    foothold: FloatArray  # (3,) of the sole in odom [m]
    left: float  # until touchdown [s]
    landing_dcm: FloatArray  # (3,) DCM at touchdown for the foothold [m]
    offset: FloatArray  # (3,) b, DCM error left to the next step [m]
    cost: float  # cost of the QP [1]


def transfer_gain(spread: float) -> float:
    """Return α, displacement of the DCM at touchdown per that of the foothold; ``spread`` is ω·T_d > 0."""
    return (1.0 - exp(-spread)) / spread


def _offset(z: Any, p: Any) -> Any:
    """Return (2,) b, the DCM error left to the next step, of the unknowns and the parameters."""
    planned, reached, predicted, alpha, beta = p[0:2], p[2:4], p[4:6], p[7], p[8]  # s; ξ_td − c; ξ_p − c; α; β
    return (predicted * z[2] + z[3:5] - reached - alpha * (z[0:2] - planned)) / beta


class StepAdjuster:
    """Solves the QP of a step."""

    def __init__(self, robot: RobotDescription) -> None:
        assert robot.tables.footsteps is not None
        self._reach, self._table = robot.tables.footsteps, robot.read(Tuning).disturbance
        feet, inset = robot.tables.feet, robot.read(Tuning).whole_body.contact_inset
        share = self._table.cop_share
        # Usable reach of the CoP from the middle of each sole, forward and sideways [m].
        self.cop = [
            (share * (0.5 * (foot.toe - foot.heel) - inset), share * (foot.half_width - inset))
            for foot in (feet.left, feet.right)
        ]
        self._sole_length = feet.left.toe - feet.left.heel
        self._parameters = np.zeros(PARAMETERS)
        self._hessian = np.zeros((UNKNOWNS, UNKNOWNS))
        self._gradient = np.zeros(UNKNOWNS)
        self._constant = np.zeros(1)
        self._evaluate = self._problem()
        self._rows = np.zeros((ROWS, UNKNOWNS))
        bounds = UNKNOWNS + ROWS
        self._upper, self._lower = np.full(bounds, UNBOUNDED), np.full(bounds, -UNBOUNDED)

    def _problem(self) -> Callable[[], None]:
        """Matrices of the objective as a function of the parameters, bound to the arrays of this object."""
        table = self._table
        z, p = ca.SX.sym("z", UNKNOWNS), ca.SX.sym("p", PARAMETERS)
        s, r, d = z[0:2], z[2], z[3:5]
        planned, growth, omega = p[0:2], p[6], p[9]
        cost = (
            table.foothold_weight * ca.sumsqr(s - planned)
            + table.time_weight * ((r - 1.0) / omega) ** 2
            + table.offset_weight * ca.sumsqr(_offset(z, p))
            + table.cop_weight * ca.sumsqr(d / (growth - 1.0))
        )
        hessian, gradient = ca.hessian(cost, z)
        at_zero = ca.substitute(ca.vertcat(gradient, cost), z, ca.DM.zeros(UNKNOWNS))
        function = ca.Function(
            "adjustment", [p], [ca.densify(hessian), ca.densify(at_zero[:UNKNOWNS]), ca.densify(at_zero[UNKNOWNS])]
        )
        buffer: Any  # casadi's stubs know only the call with sizes
        buffer, evaluate = function.buffer()
        buffer.set_arg(0, self._parameters.data)
        for i, result in enumerate((self._hessian, self._gradient, self._constant)):
            buffer.set_res(i, result.data)
        self._buffer = buffer  # keeps the buffers of ``evaluate`` alive
        fill: Callable[[], None] = evaluate
        return fill

    def adjust(self, situation: Situation) -> Adjustment | None:
        """Return the best foothold and time; None if numbers are not finite or the solver fails."""
        step, stance, omega = situation.step, situation.stance, situation.omega
        yaw = rotation.yaw(stance.rotation)
        c, s = cos(yaw), sin(yaw)
        ox, oy, _ = stance.position.tolist()

        def in_heading(vector: list[float]) -> tuple[float, float]:
            x, y, _ = vector
            return c * x + s * y, c * y - s * x

        error, centre, landing = situation.dcm_error, situation.centre, situation.landing_dcm
        ex, ey = in_heading(error.tolist())
        if not isfinite(ex + ey):
            return None
        lx, ly = in_heading((landing - centre).tolist())
        nx, ny = in_heading((step.sole.position - stance.position).tolist())
        fx, fy = in_heading((situation.swing.position - stance.position).tolist())
        left = situation.left
        growth = exp(omega * left)
        spread = omega * situation.transfer
        self._parameters[:10] = (
            nx, ny, lx, ly, lx + ex * growth, ly + ey * growth,
            growth, transfer_gain(spread), exp(-spread), omega,
        )  # fmt: skip
        self._evaluate()
        self._bound(situation, planned=(nx, ny), foot=(fx, fy), growth=growth)
        z, _, flag, _ = daqp.solve(self._hessian, self._gradient, self._rows, self._upper, self._lower)
        if flag < 1:
            return None
        x, y, ratio, _, _ = z.tolist()
        if not isfinite(x + y + ratio):
            return None
        cost = float(0.5 * z @ self._hessian @ z + self._gradient @ z + self._constant[0])
        alpha = self._parameters[7]
        mx, my = c * (x - nx) - s * (y - ny), s * (x - nx) + c * (y - ny)
        foothold = np.array((ox + c * x - s * y, oy + s * x + c * y, step.sole.position[2]))
        reached = landing + alpha * np.array((mx, my, 0.0))
        bx, by = _offset(z, self._parameters).tolist()
        offset = np.array((c * bx - s * by, s * bx + c * by, 0.0))
        return Adjustment(foothold, left + log(ratio) / omega, reached, offset, cost)

    def cost_of_two(self, first: Situation, second: Situation) -> float:
        """Return the least cost of a step and the next, which takes over the DCM error left; inf without solution.

        ``second`` is as planned: it moves with the first foothold.
        """
        found = self.adjust(first)
        if found is None:
            return inf
        moved, step, stance = found.foothold - first.step.sole.position, second.step, second.stance
        then = self.adjust(
            replace(
                second,
                step=replace(step, sole=SolePose(step.sole.position + moved, step.sole.rotation)),
                stance=SolePose(stance.position + moved, stance.rotation),
                centre=second.centre + moved,
                landing_dcm=second.landing_dcm + moved,
                dcm_error=found.offset,
            )
        )
        left = self._table.offset_weight * float(found.offset @ found.offset)
        return inf if then is None else found.cost - left + then.cost

    def within_reach(self, step: Step, stance: SolePose, foothold: FloatArray) -> FloatArray:
        """Return (3,) the permitted foothold nearest to ``foothold``, at the planned height, in odom [m]."""
        heading = rotation.yaw_matrix(rotation.yaw(stance.rotation))
        planned = heading.T @ (step.sole.position - stance.position)
        place = heading.T @ (foothold - stance.position)
        for i, (low, high) in enumerate(self._box(step, stance, planned[:2].tolist())):
            place[i] = min(max(place[i], low), high)
        place[2] = planned[2]
        result: FloatArray = stance.position + heading @ place
        return result

    def _box(self, step: Step, stance: SolePose, planned: Sequence[float]) -> list[tuple[float, float]]:
        """Bounds forward and left of the stance foot of a step with a planned position there [m]."""
        reach, table = self._reach, self._table
        turn = abs(rotation.yaw(step.sole.rotation @ stance.rotation.T))
        near = reach.min_width + table.clearance + 0.5 * self._sole_length * sin(min(turn, 1.0))
        boxes = (
            (-max(reach.max_backward, table.max_backward), reach.max_forward),
            (near, table.max_width) if step.foot == LEFT else (-table.max_width, -near),
        )
        most = step.adjustable
        ends = [
            (max(low, place - most), min(high, place + most)) for (low, high), place in zip(boxes, planned, strict=True)
        ]
        return [(min(pair), max(pair)) for pair in ends]

    def _bound(
        self, situation: Situation, *, planned: tuple[float, float], foot: tuple[float, float], growth: float
    ) -> None:
        """Set the bounds of reach, foot speed, time and CoP; positions from the stance foot [m], ``growth``: e^{ωT}."""
        step, left = situation.step, situation.left
        reach, table, omega = self._reach, self._table, situation.omega
        upper, lower, rows = self._upper, self._lower, self._rows
        side = 1.0 if step.foot == LEFT else -1.0
        pace = table.foot_speed / PEAK
        way = pace * (left + table.longest_delay)
        for i, (low, high) in enumerate(self._box(step, situation.stance, planned)):
            # The planned foothold is always allowed; a distant foot goes as near as possible within reach.
            lower[i] = min(max(low, foot[i] - way), high, planned[i])
            upper[i] = max(min(high, foot[i] + way), low, planned[i])
        soonest = min(left, situation.least)
        lower[2], upper[2] = exp(omega * (soonest - left)), exp(omega * table.longest_delay)
        # ± (s − foot) within the foot's way until touchdown, with T + ΔT ≈ T + (r − 1)/ω; what is nearest always is
        gain = pace / omega
        for row, (i, sign) in enumerate(((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)), start=6):
            rows[row, i], rows[row, 2] = sign, -gain
            nearest = max(sign * planned[i], lower[i] if sign > 0.0 else -upper[i])
            upper[5 + row] = max(sign * foot[i] + gain * (omega * left - 1.0), nearest - gain * upper[2])
        lx, ly = self.cop[1 - step.foot]
        # ± d − l·growth·r ≤ −l
        for row, (i, length) in enumerate(((3, lx), (3, lx), (4, ly), (4, ly))):
            rows[row, i] = 1.0 if row % 2 == 0 else -1.0
            rows[row, 2] = -length * growth
            upper[5 + row] = -length
        # a long step is not a wide one: |x| + width within reach
        for row, sign in ((4, 1.0), (5, -1.0)):
            rows[row, 0], rows[row, 1] = sign, side
            upper[5 + row] = max(reach.max_forward + table.diagonal_width, sign * planned[0] + side * planned[1])


class StepGuard:
    """Adjusts the step under way."""

    def __init__(self, robot: RobotDescription) -> None:
        self._table = robot.read(Tuning).disturbance
        enabled = self._table.adjust_steps and robot.tables.footsteps is not None
        self._adjuster = StepAdjuster(robot) if enabled else None
        self.situation: Situation  # of the planned step
        self._touchdown = 0.0
        self._guards = False
        self.adjusted: Adjustment | None = None  # None for the planned step

    def begin(
        self,
        step: Step,
        stance: SolePose,
        centre: FloatArray,
        *,
        landing_dcm: FloatArray,
        touchdown: float,
        transfer: float,
        omega: float,
    ) -> None:
        """Start a planned step, with the transfer of weight; ``touchdown`` is on the clock of ``update`` [s]."""
        self.adjusted = None
        self._touchdown = touchdown
        self._guards = self._adjuster is not None and step.adjustable > 0.0
        self.situation = Situation(
            step, stance, stance, centre, np.zeros(3), landing_dcm, touchdown, least=0.0, transfer=transfer, omega=omega
        )

    def update(self, time: float, lift_off: float, swing: SolePose, dcm_error: FloatArray) -> Adjustment | None:
        """Return a new foothold and time, or None without a change; ``time`` is now, ``lift_off`` of the foot [s]."""
        left, table = self._touchdown - time, self._table
        if not self._guards or left < table.final:
            return None
        x, y, _ = dcm_error.tolist()
        if self.adjusted is None and x * x + y * y < table.threshold**2:
            return None
        assert self._adjuster is not None
        least = lift_off + table.shortest_swing - time if time >= lift_off else left
        situation = replace(self.situation, swing=swing, dcm_error=dcm_error, left=left, least=max(least, table.final))
        found = self._adjuster.adjust(situation)
        if found is not None:
            self.adjusted = found
        return found

    def missed(self, left: float, foot: FloatArray, dcm: FloatArray) -> float:
        """Return how far (3,) the DCM, ``left`` [s] before touchdown, misses (3,) a landed foot [m]."""
        situation = self.situation
        moved = (foot - situation.step.sole.position) * transfer_gain(situation.omega * situation.transfer)
        then = situation.centre + (dcm - situation.centre) * exp(situation.omega * left)
        x, y, _ = (then - situation.landing_dcm - moved).tolist()
        return hypot(x, y)

    def late_vrp(self, dcm: FloatArray) -> FloatArray:
        """Return (3,) VRP that slows (3,) the DCM reference most with the CoP in the stance sole; foot late [m]."""
        situation, adjuster = self.situation, self._adjuster
        if adjuster is None:
            return situation.centre
        heading = rotation.yaw_matrix(rotation.yaw(situation.stance.rotation))
        most = adjuster.cop[1 - situation.step.foot]
        away = np.clip(heading[:2, :2].T @ (dcm - situation.centre)[:2], np.negative(most), most)
        vrp = situation.centre.copy()
        vrp[:2] += heading[:2, :2] @ away
        return vrp

    def late_foothold(self, dcm: FloatArray) -> FloatArray:
        """Return (3,) the foothold of a late foot in odom, at the planned height, for (3,) the measured DCM [m]."""
        situation, adjuster = self.situation, self._adjuster
        step = situation.step
        foothold, landing = step.sole.position, situation.landing_dcm
        if self.adjusted is not None:
            foothold, landing = self.adjusted.foothold, self.adjusted.landing_dcm
        if adjuster is None or not self._guards or not np.isfinite(dcm).all():
            return foothold
        moved = (dcm - landing) / transfer_gain(situation.omega * situation.transfer)
        return adjuster.within_reach(step, situation.stance, foothold + moved)

    def cost(self, dcm_error: FloatArray, swing: SolePose, second: Situation) -> float:
        """Return the cost of the step at its start and of a second, inf if not adjustable; arguments as elsewhere.

        The foot away from which the DCM goes makes a detour that follows its plan less well.
        """
        if self._adjuster is None or not self._guards:
            return inf
        planned, table = self.situation, self._table
        away = float(planned.stance.rotation[:, 1] @ dcm_error) * (1.0 if planned.step.foot == LEFT else -1.0) < 0.0
        least = self._touchdown - planned.step.swing_duration + table.shortest_swing
        first = replace(planned, swing=swing, dcm_error=dcm_error, least=least)
        return (table.away_cost if away else 1.0) * self._adjuster.cost_of_two(first, second)

    def reference(self, left: float) -> FloatArray:
        """Return (3,) DCM of the adjusted step [m], ``left`` [s] before touchdown."""
        assert self.adjusted is not None
        centre, omega = self.situation.centre, self.situation.omega
        dcm: FloatArray = centre + (self.adjusted.landing_dcm - centre) * exp(-omega * max(left, 0.0))
        return dcm
