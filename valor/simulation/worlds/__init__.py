"""The worlds to simulate in, by name. The robot starts with its pelvis above the origin, facing x, soles at z = 0.

A world is a row of ``WORLDS``: a generator with its parameters. What is random in it comes from the seed alone, so
that name and seed say everything: the simulation and a picture of its bag show the same ground. No controller may look
here.
"""

from __future__ import annotations

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import require_one_of
from valor.simulation.worlds.dirt import Dirt
from valor.simulation.worlds.flat import Flat
from valor.simulation.worlds.rubble import Rubble
from valor.simulation.worlds.stairs import Stairs
from valor.simulation.worlds.world import World, add_materials

# fmt: off
WORLDS: dict[str, World] = {  # named in world_names, too
    "flat":        Flat(),
    "dirt":        Dirt(course=61.0, bump_height=0.02, bump_lengths=(0.2, 1.0), slope=5.0),
    "stairs":      Stairs(rise=0.10, tread=0.3, steps=3),
    "stairs_15cm": Stairs(rise=0.15, tread=0.3, steps=3),
    "rubble":      Rubble(highest=0.04, start=0.6, length=3.0),
}
# fmt: on

_ABOVE = 10.0  # all ground [m]
_STREAM = 2  # of the seed; the plant and the sensors draw from 0 and 1


def known() -> tuple[str, ...]:
    """Names of the worlds."""
    return tuple(WORLDS)


def check(name: str) -> str:
    """A world's name, if it is one.

    Raises:
        ConfigurationError: it is none; lists the known.
    """
    require_one_of("world", name, WORLDS)
    return name


def load(name: str, seed: int) -> mujoco.MjSpec:
    """A world's spec: its ground, and nothing else.

    Geoms that the robot touches have ``contype`` 1 (see the defaults of a robot's ``model.xml``).

    Raises:
        ConfigurationError: there is no such world.
    """
    spec = mujoco.MjSpec()
    spec.modelname = check(name)
    add_materials(spec)
    WORLDS[name].add_to(spec, np.random.default_rng([seed, _STREAM]))
    return spec


def heights(name: str, seed: int, x: FloatArray, y: FloatArray) -> FloatArray:
    """(ny, nx) height of the ground a foot would meet at x (nx,) and y (ny,) [m], for pictures and experiments.

    Raises:
        ConfigurationError: there is no such world.
    """
    spec = load(name, seed)
    for geom in list(spec.geoms):
        if not geom.contype:
            spec.delete(geom)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    down, met = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
    found = [
        [_ABOVE - mujoco.mj_ray(model, data, np.array([x_, y_, _ABOVE]), down, None, 1, -1, met) for x_ in x]
        for y_ in y
    ]
    return np.array(found)
