"""A level floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import mujoco
import numpy as np

from valor.simulation.worlds.world import floor


@dataclass(frozen=True)
class Flat:
    """A level floor at z = 0."""

    def sized(self, size: float) -> Self:
        """The same for all."""
        return self

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        """Add the floor; nothing is random."""
        floor(spec)
