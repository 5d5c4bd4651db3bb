"""Boxes that nobody has told the robot about."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import mujoco
import numpy as np

from valor.simulation.worlds.world import STONE, floor, ground

_TONES = (0.52, 0.70)  # of grey, that the boxes differ by


@dataclass(frozen=True)
class Rubble:
    """A patch of boxes, about one a foot's length, of any height up to the highest, turned anyhow.

    They lie on the floor and may overlap; between them the floor shows.
    """

    highest: float  # of a box [m]
    start: float  # x at which the patch begins [m]
    length: float  # of the patch [m]
    width: float = 2.4  # [m]
    spacing: float = 0.2  # of the boxes' middles, before they are moved [m]
    sides: tuple[float, float] = (0.12, 0.30)  # shortest and longest [m]

    def sized(self, size: float) -> Self:
        """Boxes so many times as high."""
        return replace(self, highest=size * self.highest)

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        """Add floor and boxes."""
        floor(spec)
        reach = self.sides[1] / math.sqrt(2.0)  # of a corner
        xs = np.arange(self.start + reach, self.start + self.length - reach / 2, self.spacing)
        ys = np.arange(-self.width / 2 + reach, self.width / 2 - reach / 2, self.spacing)
        for x in xs:
            for y in ys:
                shift = rng.uniform(-0.25, 0.25, 2) * self.spacing
                half = rng.uniform(*self.sides, 2) / 2
                top, turn, tone = rng.uniform(0.0, self.highest), rng.uniform(0.0, np.pi), rng.uniform(*_TONES)
                if x + shift[0] - np.hypot(*half) < self.start:
                    shift[0] = self.start + np.hypot(*half) - x
                ground(
                    spec,
                    type=mujoco.mjtGeom.mjGEOM_BOX,
                    pos=[x + shift[0], y + shift[1], top / 2],
                    size=[*half, top / 2],
                    quat=[math.cos(turn / 2), 0, 0, math.sin(turn / 2)],
                    material=STONE,
                    rgba=[tone, tone, 0.98 * tone, 1.0],
                )
