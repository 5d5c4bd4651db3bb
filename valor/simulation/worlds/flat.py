"""A level floor."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from valor.simulation.worlds.world import floor


@dataclass(frozen=True)
class Flat:
    """A level floor at z = 0."""

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        """Add the floor; nothing is random."""
        floor(spec)
