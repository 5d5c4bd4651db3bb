"""Where and when the swinging foot comes down, given the DCM as it is: a small QP.

Over the time T left to touchdown the stance foot's VRP c repels the DCM, and an error e of it grows to e·e^{ωT}. The
DCM at touchdown that the plan's own timing leads to is ξ_p = ξ_td + e·e^{ωT}, with ξ_td the plan's. Other choices
change it:

    ξ' = c + (ξ_p − c)·r + d        r = e^{ωΔT} for touchdown later by ΔT;  |d| ≤ l·(r·e^{ωT} − 1) for CoPs within ± l

and the plan goes on from a foothold moved by Δs, the steps after it moved likewise, when ξ' = ξ_td + α·Δs. What is left
of the equation is the error b of the next swing's first DCM, which the steps to come will have to make good:

    β·b = ξ' − ξ_td − α·Δs          β = e^{−ωT_d},  α = (1 − β)/(ωT_d),  T_d the transfer of weight after the step

All of it is linear in (s, r, d), and time is one of the unknowns (Khadiv, Herzog, Moosavian & Righetti 2020, "Walking
control based on step timing adaptation", for point feet; here with the CoP's reach and double support):

    min  w_s·‖Δs‖² + w_t·((r − 1)/ω)² + w_b·‖b‖² + w_d·‖d/(e^{ωT} − 1)‖²   s within reach, r within the foot's speed

Without an error the plan is the optimum. The problem is written down in CasADi, which gives its matrices in a fraction
of a microsecond, and solved by DAQP.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, exp, hypot, isfinite, log, sin
from typing import Any

import casadi as ca
import daqp
import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.footsteps import LEFT
from valor.whole_body.tuning_tables import Tuning
from valor.whole_body.walking.footsteps import Step
from valor.whole_body.walking.swing import SolePose

UNBOUNDED = 1e30  # to the solver
PEAK = 1.875  # of a minimum-jerk motion's speed to its mean
UNKNOWNS = 5  # s (2), r, d (2)
PARAMETERS = 14


@dataclass(frozen=True, slots=True)
class Situation:
    """A step that is being taken, as planned and as it is."""

    step: Step  # as planned
    stance: SolePose  # the other foot
    swing: SolePose  # the foot of the step, where it is
    centre: FloatArray  # (3,) c, the VRP over the stance foot [m]
    dcm_error: FloatArray  # (3,) DCM less the plan's [m]
    landing_dcm: FloatArray  # (3,) ξ_td, the plan's at touchdown [m]
    left: float  # T: until touchdown, as planned [s]
    least: float  # that must be left [s]
    transfer: float  # T_d: of weight, after the step [s]


@dataclass(frozen=True, slots=True)
class Adjustment:
    """What to do instead."""

    foothold: FloatArray  # (3,) of the sole in odom [m]
    left: float  # until touchdown [s]
    landing_dcm: FloatArray  # (3,) the DCM at touchdown that goes with the foothold [m]
    cost: float  # of it: what it takes to keep balance [1]


def transfer_gain(spread: float) -> float:
    """α: how much further the DCM must be at touchdown, per distance of the foothold; ``spread`` is ω·T_d, above 0."""
    return (1.0 - exp(-spread)) / spread


class StepAdjuster:
    """Adjusts steps of a robot."""

    def __init__(self, robot: RobotDescription, omega: float) -> None:
        """Build the problem. The robot's ``footsteps`` table is its reach.

        Args:
            robot: its tables.
            omega: ω [1/s].
        """
        assert robot.tables.footsteps is not None
        self._reach, self._table, self._omega = robot.tables.footsteps, robot.read(Tuning).disturbance, omega
        feet, inset = robot.tables.feet, robot.read(Tuning).whole_body.contact_inset
        share = self._table.cop_share
        self._cop = [
            (share * (0.5 * (foot.toe - foot.heel) - inset), share * (foot.half_width - inset))
            for foot in (feet.left, feet.right)
        ]
        self._sole_length = feet.left.toe - feet.left.heel
        self._parameters = np.zeros(PARAMETERS)
        self._hessian = np.zeros((UNKNOWNS, UNKNOWNS))
        self._gradient = np.zeros(UNKNOWNS)
        self._constant = np.zeros(1)
        self._evaluate = self._problem()
        self._rows = np.zeros((6, UNKNOWNS))
        self._upper, self._lower = np.full(11, UNBOUNDED), np.full(11, -UNBOUNDED)

    def _problem(self) -> Callable[[], None]:
        """The objective's matrices as functions of the parameters, bound to the arrays of this object."""
        table = self._table
        z, p = ca.SX.sym("z", UNKNOWNS), ca.SX.sym("p", PARAMETERS)
        s, r, d = z[0:2], z[2], z[3:5]
        planned, reached, predicted = p[0:2], p[2:4], p[4:6]  # foothold; ξ_td − c; ξ_p − c
        growth, alpha, beta, omega = p[6], p[7], p[8], p[9]
        offset = (predicted * r + d - reached - alpha * (s - planned)) / beta
        cost = (
            table.foothold_weight * ca.sumsqr(s - planned)
            + table.time_weight * ((r - 1.0) / omega) ** 2
            + table.offset_weight * ca.sumsqr(offset)
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
        self._buffer = buffer  # keeps what ``evaluate`` works on alive
        fill: Callable[[], None] = evaluate
        return fill

    def adjust(self, situation: Situation) -> Adjustment | None:
        """The best foothold and time; None if there is none: numbers that are not finite."""
        step, stance, omega = situation.step, situation.stance, self._omega
        yaw = rotation.yaw(stance.rotation)
        c, s = cos(yaw), sin(yaw)
        ox, oy, _ = stance.position.tolist()

        def turned(vector: list[float]) -> tuple[float, float]:
            """In the stance foot's heading."""
            x, y, _ = vector
            return c * x + s * y, c * y - s * x

        error, centre, landing = situation.dcm_error, situation.centre, situation.landing_dcm
        ex, ey = turned(error.tolist())
        if not isfinite(ex + ey):
            return None
        lx, ly = turned((landing - centre).tolist())
        nx, ny = turned((step.sole.position - stance.position).tolist())
        fx, fy = turned((situation.swing.position - stance.position).tolist())
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
        return Adjustment(foothold, left + log(ratio) / omega, reached, cost)

    def cop_reach(self, foot: int) -> tuple[float, float]:
        """How far the CoP can go from the middle of a foot's sole, ahead and aside, as far as is counted on [m]."""
        return self._cop[foot]

    def within_reach(self, step: Step, stance: SolePose, foothold: FloatArray) -> FloatArray:
        """(3,) the place nearest to a foothold that a step may be moved to, at the height planned, in odom [m].

        Args:
            step: as planned.
            stance: the other foot.
            foothold: (3,) of the sole in odom [m].
        """
        heading = rotation.yaw_matrix(rotation.yaw(stance.rotation))
        planned = heading.T @ (step.sole.position - stance.position)
        place = heading.T @ (foothold - stance.position)
        for i, (low, high) in enumerate(self._box(step, stance, planned[:2].tolist())):
            place[i] = min(max(place[i], low), high)
        place[2] = planned[2]
        result: FloatArray = stance.position + heading @ place
        return result

    def _box(self, step: Step, stance: SolePose, planned: Sequence[float]) -> list[tuple[float, float]]:
        """Lowest and highest forward and left of the stance foot, where a step may go that is planned there [m]."""
        reach, table = self._reach, self._table
        turn = abs(rotation.yaw(step.sole.rotation @ stance.rotation.T))
        near = reach.min_width + table.clearance + 0.5 * self._sole_length * sin(min(turn, 1.0)), table.max_width
        boxes = (
            (-max(reach.max_backward, table.max_backward), reach.max_forward),
            near if step.foot == LEFT else (-near[1], -near[0]),
        )
        most = step.adjustable
        ends = [
            (max(low, place - most), min(high, place + most)) for (low, high), place in zip(boxes, planned, strict=True)
        ]
        return [(min(pair), max(pair)) for pair in ends]

    def _bound(
        self, situation: Situation, *, planned: tuple[float, float], foot: tuple[float, float], growth: float
    ) -> None:
        """Reach, speed of the foot, time, and the CoP's.

        Args:
            situation: of the step.
            planned: foothold, from the stance foot and in its heading [m].
            foot: that swings, likewise [m].
            growth: e^{ωT}.
        """
        step, left = situation.step, situation.left
        reach, table, omega = self._reach, self._table, self._omega
        upper, lower, rows = self._upper, self._lower, self._rows
        side = 1.0 if step.foot == LEFT else -1.0
        way = table.foot_speed * left / PEAK
        distance = 0.0
        for i, (low, high) in enumerate(self._box(step, situation.stance, planned)):
            # What is planned is always allowed; a foot far off gets as near as it can, and not beyond reach.
            lower[i] = min(max(low, foot[i] - way), high, planned[i])
            upper[i] = max(min(high, foot[i] + way), low, planned[i])
            distance = hypot(distance, planned[i] - foot[i])
        soonest = min(left, max(situation.least, PEAK * distance / table.foot_speed))
        lower[2], upper[2] = exp(omega * (soonest - left)), exp(omega * table.longest_delay)
        lx, ly = self._cop[1 - step.foot]
        # ± d − l·growth·r ≤ −l
        for row, (i, length) in enumerate(((3, lx), (3, lx), (4, ly), (4, ly))):
            rows[row, i] = 1.0 if row % 2 == 0 else -1.0
            rows[row, 2] = -length * growth
            upper[5 + row] = -length
        # a long step is not a wide one: |x| + width within reach
        for row, sign in ((4, 1.0), (5, -1.0)):
            rows[row, 0], rows[row, 1] = sign, side
            upper[5 + row] = max(reach.max_forward + table.diagonal_width, sign * planned[0] + side * planned[1])
