"""A flight of stairs up, a landing, and the same flight down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import mujoco
import numpy as np

from valor.simulation.worlds.world import EDGE, STONE, block, decoration, floor

_NOSING = (0.02, 0.002)  # of the mark on each edge: depth, how far it stands out [m]


@dataclass(frozen=True)
class Stairs:
    """Stairs across the robot's way; nothing is random.

    ::

                          ┌──────────────────┐        z = steps·rise
                    ┌─────┘     landing      └─────┐  z = 2·rise
              ┌─────┘                              └─────┐
        ──────┘                                          └──────
              x = start   each tread is ``tread`` deep
    """

    rise: float  # of a step [m]
    tread: float  # depth of a step [m]
    steps: int  # up, and down again; the last one up is the landing
    start: float = 0.5  # x of the first riser [m]
    landing: float = 1.2  # depth [m]
    width: float = 2.0  # [m]

    @property
    def up(self) -> list[float]:
        """Where the risers that lead up stand, along x [m]."""
        return [self.start + i * self.tread for i in range(self.steps)]

    @property
    def down(self) -> list[float]:
        """Where the risers that lead down stand, along x [m]."""
        first = self.up[-1] + self.landing
        return [first + i * self.tread for i in range(self.steps)]

    def sized(self, size: float) -> Self:
        """The same for all."""
        return self

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        """Add floor and steps: a box from riser to riser for each height, so that no joint lies under a foot."""
        floor(spec)
        half = self.width / 2
        depth, out = _NOSING
        edges = [*self.up, *self.down]
        heights = [*range(1, self.steps + 1), *range(self.steps - 1, 0, -1)]
        for begin, end, height in zip(edges, edges[1:], heights, strict=False):
            block(spec, (begin, end), (-half, half), height * self.rise, STONE)
        for x, height in zip(edges, [*range(1, self.steps + 1), *range(self.steps, 0, -1)], strict=True):
            inwards = depth / 2 if x in self.up else -depth / 2
            decoration(
                spec,
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[x + inwards, 0, height * self.rise - depth / 2 + out],
                size=[depth / 2 + out, half, depth / 2],
                material=EDGE,
            )
