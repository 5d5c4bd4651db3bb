"""The worlds to simulate in, by name. The robot starts with its pelvis above the origin, facing x, soles at z = 0.

A world is a row of ``WORLDS``: a generator with its parameters. What is random in it comes from the seed alone, and how
high bumps and boxes are goes by the robot's legs, so that name, seed and robot say everything: the simulation and a
picture of its bag show the same ground. No controller may look here.
"""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.errors import require_one_of
from valor.robot.description import RobotDescription
from valor.robot.size import ESCHER
from valor.simulation.worlds.dirt import Dirt
from valor.simulation.worlds.door import Door
from valor.simulation.worlds.flat import Flat
from valor.simulation.worlds.rubble import Rubble
from valor.simulation.worlds.stairs import Stairs
from valor.simulation.worlds.valve import Valve
from valor.simulation.worlds.world import Spread, World, add_materials

DOOR, VALVE = Spread((0.95, 1.45), (-0.35, 0.15), 0.2), Spread((1.0, 1.5), (-0.3, 0.3), 0.2)
UNYIELDING = 1e5  # damping of what does not give [N·m·s/rad]
# fmt: off
WORLDS: dict[str, World] = {  # named in world_names, too
    "flat":        Flat(),
    "dirt":        Dirt(course=61.0, bump_height=0.02, bump_lengths=(0.2, 1.0), slope=5.0),
    "stairs":      Stairs(rise=0.10, tread=0.3, steps=3),
    "stairs_15cm": Stairs(rise=0.15, tread=0.3, steps=3),
    "rubble":      Rubble(highest=0.04, start=0.6, length=3.0),
    "door":        Door(start=DOOR),
    "door_shut":   Door(start=DOOR, closer=UNYIELDING),
    "valve":       Valve(start=VALVE),
    "valve_stuck": Valve(start=VALVE, damping=UNYIELDING),
}
# fmt: on

PREFIX = "world/"
"""Of all names in a world that a robot stands in."""

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


def load(name: str, seed: int, size: float = 1.0) -> mujoco.MjSpec:
    """A world's spec: its ground and what stands on it, for a robot of a ``size_of``.

    Geoms that the robot touches have ``contype`` 1 (see the defaults of a robot's ``model.xml``).

    Raises:
        ConfigurationError: there is no such world.
    """
    spec = mujoco.MjSpec()
    spec.modelname = check(name)
    spec.compiler.degree = False
    add_materials(spec)
    WORLDS[name].sized(size).add_to(spec, stream(seed))
    return spec


def stream(seed: int) -> np.random.Generator:
    """By which a world is made."""
    return np.random.default_rng([seed, _STREAM])


def joints(model: mujoco.MjModel) -> npt.NDArray[np.intp]:
    """(m,) places in ``qpos`` of the joints that the world of a model has."""
    names = (model.joint(i).name for i in range(model.njnt))
    return np.array([model.joint(name).qposadr[0] for name in names if name.startswith(PREFIX)], dtype=np.intp)


def size_of(robot: RobotDescription) -> float:
    """How many times as long its legs are as ESCHER's."""
    return robot.tables.size.leg / ESCHER.leg


def heights(name: str, seed: int, x: FloatArray, y: FloatArray, size: float = 1.0) -> FloatArray:
    """(ny, nx) height of the ground a foot would meet at x (nx,) and y (ny,) [m], for pictures and experiments.

    Raises:
        ConfigurationError: there is no such world.
    """
    model = load(name, seed, size).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    model.geom_group[:] = np.where((model.geom_contype & 1) & (model.geom_bodyid == 0), 0, 1)
    groups = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
    down, met = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
    found = [
        [_ABOVE - mujoco.mj_ray(model, data, np.array([x_, y_, _ABOVE]), down, groups, 1, -1, met) for x_ in x]
        for y_ in y
    ]
    return np.array(found)
