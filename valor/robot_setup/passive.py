"""Joints that nothing drives: which are simulated and which welded, and what couples them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.robot_setup.questions import Ask, Question
from valor.robot_setup.source import Source

_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_BY_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


@dataclass(frozen=True)
class Coupling:
    """A joint that follows another by a polynomial of its angle."""

    follower: int
    leader: int
    polynomial: FloatArray  # (5,) from the constant on; angles from zero [rad]
    softness: str  # attributes of MJCF


@dataclass(frozen=True)
class Loop:
    """Two bodies with a point in common; (3,) each, in the world as drawn [m]."""

    bodies: tuple[int, int]
    points: tuple[FloatArray, FloatArray]
    softness: str


@dataclass
class Passive:
    """What nothing drives.

    Attributes:
        hinges: whether each is simulated; if not, it is welded.
        gone: slides and balls, which are welded for good.
        couplings, loops: what holds simulated hinges.
    """

    hinges: dict[int, bool] = field(default_factory=dict)
    gone: list[int] = field(default_factory=list)
    couplings: list[Coupling] = field(default_factory=list)
    loops: list[Loop] = field(default_factory=list)

    @property
    def simulated(self) -> set[int]:
        """Hinges that are."""
        return {joint for joint, moves in self.hinges.items() if moves}


def sort_joints(source: Source, bodies: Collection[int], ask: Ask) -> tuple[set[int], Passive]:
    """The driven hinges of some bodies, and what nothing drives.

    Hinges that an actuator acts on are driven; all where there are no actuators; those that follow others are not.

    Raises:
        ConfigurationError: what is driven is no hinge.
    """
    return _Sorter(source, bodies, ask).sort()


class _Sorter:
    def __init__(self, source: Source, bodies: Collection[int], ask: Ask) -> None:
        self.source, self.mj, self.ask, self.bodies = source, source.mj, ask, set(bodies)
        self.joints = [j for j in range(self.mj.njnt) if int(self.mj.jnt_bodyid[j]) in self.bodies]
        self.acted = {
            int(self.mj.actuator_trnid[a, 0])
            for a in range(self.mj.nu)
            if int(self.mj.actuator_trntype[a]) in _BY_JOINT
        }

    def sort(self) -> tuple[set[int], Passive]:
        mj = self.mj
        hinges = [j for j in self.joints if mj.jnt_type[j] == _HINGE]
        gone = [j for j in self.joints if mj.jnt_type[j] not in {_HINGE, int(mujoco.mjtJoint.mjJNT_FREE)}]
        for joint in gone:
            if joint in self.acted:
                name = self.source.joints[joint]
                raise ConfigurationError(
                    f"{self.source.file}: joint {name} is driven and slides or is a ball; expected hinges"
                )
        couplings = self._couplings()
        following = {each.follower for each in couplings}
        loops = [(loop, joints) for loop, joints in self._loops() if not joints.intersection(gone)]
        driven = {j for j in hinges if (j in self.acted or not self.acted) and j not in following}
        idle = [j for j in hinges if j not in driven and j not in following]
        looped = set[int]().union(*(joints for _, joints in loops))
        moving = dict.fromkeys(sorted(following), True)
        for chosen, guess in (([j for j in idle if self._held(j, looped)], "simulate"), (idle, "weld")):
            if left := [j for j in chosen if j not in moving]:
                names = ", ".join(self.source.joints[j] for j in left)
                question = Question(f"nothing drives {names}: simulate or weld them, or give them servos", guess,
                                    ("simulate", "weld", "servo"))  # fmt: skip
                answer = self.ask(question)
                moving |= dict.fromkeys(left, answer == "simulate")
                driven |= set(left) if answer == "servo" else set()
        found = Passive({j: moving[j] for j in hinges if j in moving and j not in driven}, gone, couplings)
        for loop, joints in loops:
            if joints <= driven | found.simulated and joints & found.simulated:
                found.loops.append(loop)
            else:
                self._leave_out(loop.bodies, "its joints are all driven, or welded")
        return driven, found

    def _held(self, joint: int, looped: set[int]) -> bool:
        """Whether something brings a joint to rest: a spring, damping, friction, or the loop that it is in."""
        dof = int(self.mj.jnt_dofadr[joint])
        held = self.mj.jnt_stiffness[joint] > 0 or self.mj.dof_damping[dof] > 0 or self.mj.dof_frictionloss[dof] > 0
        return bool(held) or joint in looped

    def _leave_out(self, bodies: tuple[int, int], why: str) -> None:
        one, other = (self.source.bodies[body] for body in bodies)
        self.source.notes.append(f"what joins {one} and {other} is left out: {why}")

    def _equalities(self, kind: mujoco.mjtEq) -> list[int]:
        return [e for e in range(self.mj.neq) if self.mj.eq_type[e] == kind and self.mj.eq_active0[e]]

    def _softness(self, equality: int) -> str:
        solref, solimp = (" ".join(f"{x:g}" for x in what[equality]) for what in (self.mj.eq_solref, self.mj.eq_solimp))
        return f'solref="{solref}" solimp="{solimp}"'

    def _couplings(self) -> list[Coupling]:
        mj, found = self.mj, []
        for equality in self._equalities(mujoco.mjtEq.mjEQ_JOINT):
            follower, leader = int(mj.eq_obj1id[equality]), int(mj.eq_obj2id[equality])
            if leader < 0 or follower not in self.joints or mj.jnt_type[follower] != _HINGE:
                continue
            ours = np.polynomial.Polynomial(mj.eq_data[equality, :5])
            zeros = [float(mj.qpos0[mj.jnt_qposadr[joint]]) for joint in (follower, leader)]
            polynomial = ours(np.polynomial.Polynomial([-zeros[1], 1.0])) + zeros[0]
            softness = self._softness(equality)
            if follower in self.acted and leader not in self.acted and polynomial.degree() == 1:
                offset, slope = map(float, polynomial.coef)
                follower, leader = leader, follower
                polynomial = np.polynomial.Polynomial([-offset / slope, 1 / slope])
            coefficients = np.zeros(5)
            coefficients[: len(polynomial.coef)] = polynomial.coef
            found.append(Coupling(follower, leader, coefficients, softness))
        return found

    def _loops(self) -> list[tuple[Loop, set[int]]]:
        """Each with the joints in it."""
        mj, data, found = self.mj, self.source.data, []
        for equality in self._equalities(mujoco.mjtEq.mjEQ_CONNECT):
            ends = int(mj.eq_obj1id[equality]), int(mj.eq_obj2id[equality])
            if mj.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
                bodies = int(mj.site_bodyid[ends[0]]), int(mj.site_bodyid[ends[1]])
                points = data.site_xpos[ends[0]].copy(), data.site_xpos[ends[1]].copy()
            else:
                bodies = ends
                anchors = mj.eq_data[equality, :3], mj.eq_data[equality, 3:6]
                one, other = (
                    data.xpos[body] + self.source.rotation(body) @ anchor
                    for body, anchor in zip(bodies, anchors, strict=True)
                )
                points = one, other
            if set(bodies) <= self.bodies:
                found.append((Loop(bodies, points, self._softness(equality)), self._between(*bodies)))
        for equality in self._equalities(mujoco.mjtEq.mjEQ_WELD):
            self._leave_out((int(mj.eq_obj1id[equality]), int(mj.eq_obj2id[equality])), "it welds them")
        return found

    def _between(self, one: int, other: int) -> set[int]:
        """Joints on the way between two bodies."""
        ways = []
        for end in (one, other):
            body, way = end, set[int]()
            while body:
                first = int(self.mj.body_jntadr[body])
                way |= set(range(first, first + int(self.mj.body_jntnum[body])))
                body = int(self.mj.body_parentid[body])
            ways.append(way)
        return ways[0] ^ ways[1]
