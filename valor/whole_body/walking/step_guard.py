"""Watches over the step that is being taken: when the DCM leaves its plan too far, another foothold and time.

A step is left alone while the error is small: the CoP makes good for that. From then on until shortly before touchdown,
foothold and time follow the DCM every period (``step_adjustment``), and so does the DCM's reference,
ξ(t) = c + (ξ_td − c)·e^{ω(t − T)} with the VRP c over the stance foot. While weight is still being transferred the
foothold alone follows.

A foot that finds no ground when it should is late, and the DCM does not wait: it moves on, away from the stance foot.
The CoP under that foot goes after it, to the sole's edge, which slows it down; and the foothold moves on with it, by
the ξ' = ξ_td + α·Δs of ``step_adjustment``: the foot comes down where the DCM needs it then.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp, inf

import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.whole_body.tuning_tables import Tuning
from valor.whole_body.walking.footsteps import Step
from valor.whole_body.walking.step_adjustment import Adjustment, Situation, StepAdjuster, transfer_gain
from valor.whole_body.walking.swing import SolePose


class StepGuard:
    """One step after the other.

    Attributes:
        adjusted: the adjustment that holds, or None: the step is as planned.
    """

    def __init__(self, robot: RobotDescription, omega: float) -> None:
        """Args: omega: ω [1/s]."""
        self._table, self._omega = robot.read(Tuning).disturbance, omega
        enabled = self._table.adjust_steps and robot.tables.footsteps is not None
        self._adjuster = StepAdjuster(robot, omega) if enabled else None
        self._situation: Situation
        self._touchdown = 0.0
        self._guards = False
        self.adjusted: Adjustment | None = None

    def begin(
        self,
        step: Step,
        stance: SolePose,
        centre: FloatArray,
        *,
        landing_dcm: FloatArray,
        touchdown: float,
        transfer: float,
    ) -> None:
        """A step begins, with the transfer of weight.

        Args:
            step: as planned.
            stance: the sole of the other foot.
            centre: (3,) VRP over it [m].
            landing_dcm: (3,) DCM planned for touchdown [m].
            touchdown: planned, on the clock of ``update`` [s].
            transfer: of weight, planned after the step [s].
        """
        self.adjusted = None
        self._touchdown = touchdown
        self._guards = self._adjuster is not None and step.adjustable > 0.0
        self._situation = Situation(
            step, stance, stance, centre, np.zeros(3), landing_dcm, left=touchdown, least=0.0, transfer=transfer
        )

    def update(self, time: float, lift_off: float, swing: SolePose, dcm_error: FloatArray) -> Adjustment | None:
        """Another foothold or time; None: nothing changes.

        Args:
            time: now [s].
            lift_off: when the foot leaves or left the ground [s].
            swing: the sole that swings or will, as it is.
            dcm_error: (3,) measured DCM less the planned one [m].
        """
        left, table = self._touchdown - time, self._table
        if not self._guards or left < table.final:
            return None
        x, y, _ = dcm_error.tolist()
        if self.adjusted is None and x * x + y * y < table.threshold**2:
            return None
        assert self._adjuster is not None
        least = lift_off + table.shortest_swing - time if time >= lift_off else left
        situation = replace(self._situation, swing=swing, dcm_error=dcm_error, left=left, least=max(least, table.final))
        found = self._adjuster.adjust(situation)
        if found is not None:
            self.adjusted = found
        return found

    def late_vrp(self, dcm: FloatArray) -> FloatArray:
        """(3,) VRP that holds the DCM's reference back best, with the CoP in the stance sole, while the foot is late.

        Args:
            dcm: (3,) reference [m].
        """
        situation, adjuster = self._situation, self._adjuster
        if adjuster is None:
            return situation.centre
        heading = rotation.yaw_matrix(rotation.yaw(situation.stance.rotation))
        most = adjuster.cop_reach(1 - situation.step.foot)
        away = np.clip(heading[:2, :2].T @ (dcm - situation.centre)[:2], np.negative(most), most)
        vrp = situation.centre.copy()
        vrp[:2] += heading[:2, :2] @ away
        return vrp

    def late_foothold(self, dcm: FloatArray) -> FloatArray:
        """(3,) of the sole, where a foot that is late shall come down, in odom, at the height planned [m].

        Args:
            dcm: (3,) measured [m].
        """
        situation, adjuster = self._situation, self._adjuster
        step = situation.step
        foothold, landing = step.sole.position, situation.landing_dcm
        if self.adjusted is not None:
            foothold, landing = self.adjusted.foothold, self.adjusted.landing_dcm
        if adjuster is None or not self._guards or not np.isfinite(dcm).all():
            return foothold
        moved = (dcm - landing) / transfer_gain(self._omega * situation.transfer)
        return adjuster.within_reach(step, situation.stance, foothold + moved)

    def cost(self, dcm_error: FloatArray) -> float:
        """What it takes to keep balance with this step, as it begins [1]; infinite: it cannot be adjusted.

        Args:
            dcm_error: (3,) measured DCM less the planned one [m].
        """
        if self._adjuster is None or not self._guards:
            return inf
        found = self._adjuster.adjust(replace(self._situation, dcm_error=dcm_error, least=self._touchdown))
        return inf if found is None else found.cost

    @property
    def centre(self) -> FloatArray:
        """(3,) VRP over the stance foot [m]."""
        return self._situation.centre

    def reference(self, left: float) -> FloatArray:
        """(3,) the adjusted step's DCM [m] so long before its touchdown [s]."""
        assert self.adjusted is not None
        centre = self._situation.centre
        dcm: FloatArray = centre + (self.adjusted.landing_dcm - centre) * exp(-self._omega * max(left, 0.0))
        return dcm
