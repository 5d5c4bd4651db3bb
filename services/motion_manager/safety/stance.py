"""Whether a robot stands: upright, and with its weight on both feet."""

from __future__ import annotations

from math import acos, degrees

from valor.robot.description import RobotDescription
from valor.whole_body.state import RobotState
from valor.whole_body.tuning_tables import Tuning

UPRIGHT = 0.5  # of the tilt at which the robot counts as falling: at most so much to stand
FOOT_LOAD = 0.15  # of the robot's weight: at least so much on each foot to stand
FEET_LOAD = 0.6  # likewise on both together


class Stance:
    """Says what a state has against standing; an empty text: nothing."""

    def __init__(self, robot: RobotDescription, weight: float) -> None:
        """``weight`` of the robot [N]."""
        self._weight = weight
        self._tilt = UPRIGHT * robot.read(Tuning).fall.tilt

    def lost(self, state: RobotState) -> str:
        """Why it does not stand."""
        return self.not_upright(state) or self.not_loaded(state)

    def not_upright(self, state: RobotState) -> str:
        """That the pelvis is tilted too far."""
        tilt = acos(min(1.0, max(-1.0, float(state.pelvis_rotation_in_odom[2, 2]))))
        if tilt <= self._tilt:
            return ""
        return f"the pelvis is tilted {degrees(tilt):.0f}°; expected at most {degrees(self._tilt):.0f}°"

    def not_loaded(self, state: RobotState) -> str:
        """That a foot, or both together, carry too little."""
        left, right = state.foot_forces.tolist()
        for foot, force in (("left", left), ("right", right)):
            if force < FOOT_LOAD * self._weight:
                return f"the {foot} foot carries {force:.0f} N; expected at least {FOOT_LOAD * self._weight:.0f} N"
        if left + right < FEET_LOAD * self._weight:
            return f"the feet carry {left + right:.0f} N; expected at least {FEET_LOAD * self._weight:.0f} N"
        return ""
