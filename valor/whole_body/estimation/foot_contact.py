"""Does a foot stand? How probably, from what it feels and from whether it moves as standing feet do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from valor.common.kernel import Expression, by_rows
from valor.robot.tables import Foot

SURPRISE_TIME = 0.02  # over which surprise is averaged, so that noise alone is none [s]
LEAST = 0.05  # probability of a foot in contact: it never says nothing at all
SIZE = 12


class Past(NamedTuple):
    """What is remembered of a foot, as expressions; all zero: it is in the air."""

    touching: Expression  # whether it carried weight
    stood: Expression  # for how long [s]
    surprise: Expression  # squared, in standard deviations, averaged
    rotation: Expression  # (3, 3) of the sole in odom

    @classmethod
    def of(cls, numbers: Expression) -> Past:
        """From (12,) numbers, one field after another, row by row."""
        return cls(numbers[0], numbers[1], numbers[2], by_rows(numbers[3:12]))

    @property
    def numbers(self) -> Expression:
        """(12,) numbers, one field after another, row by row."""
        return ca.vertcat(self.touching, self.stood, self.surprise, ca.vec(self.rotation.T))


class FootContact(NamedTuple):
    """One foot in one period, in odom's axes, as expressions."""

    touching: Expression  # whether the foot carries weight, with hysteresis
    landed: Expression  # whether it has begun to in this period
    probability: Expression  # that it stands still, 0 to 1
    force: Expression  # vertical [N]
    cop: Expression  # (3,) centre of pressure from the sole's origin [m]
    rolled: Expression  # (3,) how far the sole's origin has moved since, while the centre of pressure stood still [m]
    yaw: Expression  # of the sole [rad]
    past: Past  # for the next period


@dataclass(frozen=True, slots=True)
class FootSense:
    """What a foot is known by."""

    foot: Foot  # its sole
    on: float  # vertical force from which on it surely carries weight [N]
    off: float  # until which it surely does not [N]
    settling: float  # how long it takes to come to rest [s]
    gate: float  # squared surprise (standard deviations), averaged, that a standing foot may give

    def feel(
        self, past: Past, rotation: Expression, wrench: Expression, surprise: Expression, dt: Expression
    ) -> FootContact:
        """The foot in this period.

        Args:
            past: of the last period.
            rotation: (3, 3) of the sole in odom.
            wrench: (6,) at the sole, in sole [N, N·m].
            surprise: how far its leg's last measurement was from what was expected, squared, in standard deviations.
            dt: since the last period [s].
        """
        fz, tx, ty = wrench[2], wrench[3], wrench[4]
        force = (rotation @ wrench[:3])[2]
        touching = force >= ca.if_else(past.touching, self.off, self.on)
        pressed = fz > self.off
        foot = self.foot
        x = ca.if_else(pressed, ca.fmin(ca.fmax(-ty / fz, foot.heel), foot.toe), 0.0)
        y = ca.if_else(pressed, ca.fmin(ca.fmax(tx / fz, -foot.half_width), foot.half_width), 0.0)
        place = ca.vertcat(x, y, 0.0)
        stood = ca.if_else(past.touching, past.stood + dt, 0.0)
        averaged = past.surprise + (surprise - past.surprise) * ca.fmin(1.0, dt / SURPRISE_TIME)
        loaded = ca.fmin(1.0, (force - self.off) / (self.on - self.off))
        still = ca.fmin(1.0, self.gate / ca.fmax(averaged, 1e-9)) ** 2
        settled = ca.fmin(1.0, stood / self.settling)
        return FootContact(
            touching=touching,
            landed=ca.logic_and(touching, ca.logic_not(past.touching)),
            probability=ca.if_else(touching, ca.fmax(LEAST, loaded * settled * still), 0.0),
            force=force,
            cop=rotation @ place,
            rolled=(past.rotation - rotation) @ place,
            yaw=ca.atan2(rotation[1, 0], rotation[0, 0]),
            past=Past(touching, ca.if_else(touching, stood, 0.0), ca.if_else(touching, averaged, 0.0), rotation),
        )
