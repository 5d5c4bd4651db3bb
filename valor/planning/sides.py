"""Which joints and bodies of a robot do the same on either side, whatever they are called."""

from __future__ import annotations

import mujoco
import numpy as np

from valor.robot.model import Model

_LEFT, _RIGHT = "left_", "right_"  # how groups of either side begin


class Sides:
    """Joints by the groups, in which twins have the same places; bodies by their joints, or where they are."""

    def __init__(self, model: Model) -> None:
        """Pair the joints.

        Raises:
            ConfigurationError: a group of the left has another number of joints than its twin.
        """
        robot, self._mj, self._above = model.robot, model.mj, model.joints_above
        groups = robot.tables.groups
        self._twins: dict[str, str] = {}
        for name in groups:
            if name.startswith(_LEFT):
                left, right = groups[name], robot.tables.group(_RIGHT + name.removeprefix(_LEFT))
                if len(left) != len(right):
                    what = f"{len(left)} joints, and its twin {len(right)}; expected as many on either side"
                    raise robot.error(["groups", name], what)
                self._twins |= dict(zip(left, right, strict=True))
        self._right = frozenset(self._twins.values())
        data = mujoco.MjData(self._mj)
        data.qpos[:] = model.nominal_qpos()
        mujoco.mj_kinematics(self._mj, data)
        self._places = data.xpos

    def joint(self, name: str) -> str:
        """The same joint of the right side for one of the left; any other is its own."""
        return self._twins.get(name, name)

    def body(self, name: str) -> str:
        """Likewise of a body."""
        mj = self._mj
        body = int(mj.body(name).id)
        above = self._above(body)
        if not above or above[0] not in self._twins:
            return name
        twin = int(mj.joint(self._twins[above[0]]).bodyid[0])
        if not mj.body_jntnum[body]:  # of those that hang fixed where the twin does, the nearest in the mirror
            seen = self._places[body] * (1.0, -1.0, 1.0)
            fixed = [each for each in range(mj.nbody) if self._above(each)[:1] == [self._twins[above[0]]]]
            twin = min(fixed, key=lambda each: float(np.linalg.norm(self._places[each] - seen)))
        return str(mj.body(twin).name)

    def is_right(self, body: int) -> bool:
        """Whether a body is of the right side: a joint above it is."""
        return bool(self._right.intersection(self._above(body)))
