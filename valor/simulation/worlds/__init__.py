"""Worlds of the simulation, by name. The robot starts with its pelvis above the origin, facing x, soles at z = 0.

A world is a row of ``WORLDS``: a generator with parameters. Name, seed and robot (heights of bumps and boxes scale with
its legs) determine a world completely, so a film of a bag shows the same ground as the simulation. Controllers do not
import this package.
"""

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.errors import require_one_of
from valor.robot.description import RobotDescription
from valor.robot.size import ESCHER
from valor.simulation.worlds.courses import Dirt, Rubble, Stairs
from valor.simulation.worlds.fixtures import Door, Valve
from valor.simulation.worlds.world import Spread, World, add_materials

DOOR, VALVE = Spread((0.95, 1.45), (-0.35, 0.15), 0.2), Spread((1.0, 1.5), (-0.3, 0.3), 0.2)
UNYIELDING = 1e5  # damping of blocked joints [N·m·s/rad]
# fmt: off
WORLDS: dict[str, World] = {  # names: also in world_names
    "flat":        World(),
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
"""Prefix of all names of a world in a model with a robot."""

_ABOVE = 10.0  # height above all ground [m]
_STREAM = 2  # of the seed; 0 and 1: plant and sensors


def load(name: str, seed: int, size: float = 1.0) -> mujoco.MjSpec:
    """A world's spec: ground and fixtures, for a robot of a ``size_of``.

    Geoms that the robot touches have ``contype`` 1 (see the defaults of a robot's ``model.xml``).
    Raises ConfigurationError: unknown world.
    """
    require_one_of("world", name, WORLDS)
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = False
    add_materials(spec)
    WORLDS[name].sized(size).add_to(spec, stream(seed))
    return spec


def stream(seed: int) -> np.random.Generator:
    """Random numbers of a world."""
    return np.random.default_rng([seed, _STREAM])


def joints(model: mujoco.MjModel) -> npt.NDArray[np.intp]:
    """(m,) indices in ``qpos`` of the joints of a model's world."""
    names = (model.joint(i).name for i in range(model.njnt))
    return np.array([model.joint(name).qposadr[0] for name in names if name.startswith(PREFIX)], dtype=np.intp)


def size_of(robot: RobotDescription) -> float:
    """Leg length relative to ESCHER's."""
    return robot.tables.size.leg / ESCHER.leg


def heights(name: str, seed: int, x: FloatArray, y: FloatArray, size: float = 1.0) -> FloatArray:
    """(ny, nx) height of the ground at x (nx,) and y (ny,) [m]. Raises ConfigurationError: unknown world."""
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
