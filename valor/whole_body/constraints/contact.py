"""Contact forces of the feet as non-negative generators.

Each sole has four contact points, each point a friction pyramid of four edges; a force in the pyramid is a
non-negative sum ρ of its edges. Sums of such forces have their centre of pressure within the points' rectangle: the
CoP limit, unilaterality and friction are all of ρ ≥ 0 (Koolen et al. 2016, section 4.2).
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression, Kernel
from valor.robot.description import RobotDescription
from valor.robot.tables import Foot
from valor.whole_body.tuning_tables import Tuning

POINTS = 4
EDGES = 4
GENERATORS = POINTS * EDGES  # a foot
UNBOUNDED = 1e30  # to the solver


def contact_points(foot: Foot, inset: float) -> FloatArray:
    """(4, 3) contact points in the sole's frame [m], pulled in from the edges by ``inset``."""
    x = (foot.heel + inset, foot.toe - inset)
    y = (foot.half_width - inset, -foot.half_width + inset)
    return np.array([(px, py, 0.0) for px in x for py in y])


def sole_generators(points: FloatArray, friction: float) -> FloatArray:
    """(6, 16) wrenches (force, torque at the sole's origin, in sole) of unit vertical force along each edge.

    The edges lie within the cone of ``friction``: a pyramid inscribed, tangential parts μ/√2 along both axes.
    """
    t = friction / np.sqrt(2.0)
    edges = np.array([(t, t, 1.0), (t, -t, 1.0), (-t, t, 1.0), (-t, -t, 1.0)])
    wrenches = [np.concatenate((edge, np.cross(point, edge))) for point in points for edge in edges]
    return np.array(wrenches).T


class FootContacts:
    """Generators of both feet, turned into generalised forces.

    Attributes:
        count: 32 generators, 16 of the left foot first.
        forces: (32, nv) generalised force of each generator: wrenchᵀ·J.
    """

    def __init__(self, robot: RobotDescription, nv: int) -> None:
        feet, table = robot.tables.feet, robot.read(Tuning).whole_body
        self.points = np.array([contact_points(foot, table.contact_inset) for foot in (feet.left, feet.right)])
        self.count = 2 * GENERATORS
        self.forces = np.zeros((self.count, nv))
        self._in_sole = np.array([sole_generators(points, table.friction).T for points in self.points])
        self._in_odom = np.zeros((2, GENERATORS, 6))
        self._vertical = self._in_odom[:, :, 2]
        self._left, self._right = self.forces[:GENERATORS], self.forces[GENERATORS:]
        self._rotation = np.zeros((2, 3, 3))
        self._turn = Kernel("generators", self._expressions, (self._rotation,), (self._in_odom,))

    def upper(self, load: Sequence[float], weight: float) -> FloatArray:
        """(32,) upper bounds of the generators [N].

        Args:
            load: how much each foot may push: 0 not at all, 1 as it likes.
            weight: of the robot [N].
        """
        return np.repeat([share * (weight / POINTS) if share < 1.0 else UNBOUNDED for share in load], GENERATORS)

    def update(self, sole_jacobian: FloatArray, sole_rotation: FloatArray) -> None:
        """Turn the generators with the soles.

        Args:
            sole_jacobian: (12, nv) left linear, left angular, right linear, right angular, in odom.
            sole_rotation: (2, 3, 3).
        """
        self._rotation[:] = sole_rotation
        self._turn()
        np.dot(self._in_odom[0], sole_jacobian[:6], self._left)
        np.dot(self._in_odom[1], sole_jacobian[6:], self._right)

    def _expressions(self, rotations: Expression) -> Sequence[Expression]:
        """(32, 6) the generators of both feet in odom."""
        turned = []
        for foot, rotation in enumerate(ca.vertsplit(rotations, 3)):
            generators = ca.DM(self._in_sole[foot])
            turned.append(ca.horzcat(generators[:, :3] @ rotation.T, generators[:, 3:] @ rotation.T))
        return [ca.vertcat(*turned)]

    def vertical_forces(self, rho: FloatArray) -> FloatArray:
        """(2,) vertical force of each foot [N]."""
        forces: FloatArray = np.vecdot(self._vertical, rho.reshape(2, GENERATORS))
        return forces
