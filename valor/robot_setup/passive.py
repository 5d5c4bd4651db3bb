"""Joints without a drive: which are simulated and which are welded, and the constraints on them."""

from collections.abc import Collection
from dataclasses import dataclass, field

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.robot_setup.source import Question, Source

_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_EQ = mujoco.mjtEq
_LOOPS = (_EQ.mjEQ_CONNECT, _EQ.mjEQ_WELD)
_HEAVIER = 2.0  # least mass beyond a joint, relative to that beyond its motor, that a transmission moves
_BY_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


@dataclass(frozen=True)
class Coupling:
    """Joint whose angle is a polynomial of another joint's."""

    follower: int
    leader: int
    polynomial: FloatArray  # (5,) constant first; angles from zero [rad]
    softness: str  # MJCF attributes


@dataclass(frozen=True)
class Loop:
    """Two bodies connected at a point; ``points`` are (3,) each, as drawn [m]."""

    bodies: tuple[int, int]
    points: tuple[FloatArray, FloatArray]
    softness: str
    joints: frozenset[int]  # of both branches, up to their common body


@dataclass
class PassiveJoints:
    """Joints without a drive."""

    hinges: dict[int, bool]  # whether it is simulated; otherwise it is welded
    unsupported: list[int]  # slides and ball joints; always welded
    couplings: list[Coupling]
    loops: list[Loop] = field(default_factory=list)

    @property
    def simulated(self) -> set[int]:
        """Simulated hinges."""
        return {joint for joint, simulated in self.hinges.items() if simulated}

    def weld(self, joints: Collection[int]) -> None:
        """Weld joints, also driven ones, and omit the loops through them."""
        self.hinges |= dict.fromkeys(sorted(joints), False)
        self.loops = [loop for loop in self.loops if not loop.joints.intersection(joints)]


class JointClassifier:
    """Divides the joints of bodies into driven and passive ones.

    Driven are hinges with an actuator, or without any actuators all that have no spring. Where motors move heavier
    parts through gears, rods or tendons, the joints of these parts are driven in their place.
    """

    def __init__(self, source: Source, bodies: Collection[int]) -> None:
        self.source, self.mj, self.bodies = source, source.mj, set(bodies)
        self.joints = [j for j in range(self.mj.njnt) if int(self.mj.jnt_bodyid[j]) in self.bodies]
        self.actuated = {
            int(self.mj.actuator_trnid[a, 0])
            for a in range(self.mj.nu)
            if int(self.mj.actuator_trntype[a]) in _BY_JOINT
        }

    def classify(self) -> tuple[set[int], PassiveJoints]:
        """Return both. Raises ConfigurationError if a driven joint is not a hinge."""
        mj = self.mj
        hinges = [j for j in self.joints if mj.jnt_type[j] == _HINGE]
        unsupported = [j for j in self.joints if mj.jnt_type[j] not in {_HINGE, int(mujoco.mjtJoint.mjJNT_FREE)}]
        transmissions = self._replace_motors()
        if faulty := self.actuated.intersection(unsupported):
            name = self.source.joints[min(faulty)]
            raise self.source.fail(f"joint {name} is driven and slides or is a ball; expected hinges")
        couplings = [each for each in self._couplings() if not {each.follower, each.leader} & transmissions]
        followers = {each.follower for each in couplings}
        loops = [loop for loop in self._loops() if not loop.joints & {*unsupported, *transmissions}]
        candidates = self.actuated or {j for j in hinges if not mj.jnt_stiffness[j]}
        driven = {j for j in hinges if j in candidates and j not in followers}
        idle = [j for j in hinges if j not in driven and j not in followers and j not in transmissions]
        looped = set[int]().union(*(loop.joints for loop in loops))
        simulated = dict.fromkeys(sorted(followers), True)
        for chosen, guess in (([j for j in idle if self._is_held(j, looped)], "simulate"), (idle, "weld")):
            if left := [j for j in chosen if j not in simulated]:
                names = ", ".join(self.source.joints[j] for j in left)
                text = f"no actuator drives {names}: simulate or weld them, or give them servos"
                answer = self.source.ask(Question(text, guess, ("simulate", "weld", "servo")))
                simulated |= dict.fromkeys(left, answer == "simulate")
                driven |= set(left) if answer == "servo" else set()
        passive = {j: simulated[j] for j in hinges if j in simulated and j not in driven}
        found = PassiveJoints(passive, unsupported, couplings)
        found.weld({*hinges} & transmissions - driven)
        for loop in loops:
            if loop.joints <= driven | found.simulated and loop.joints & found.simulated:
                found.loops.append(loop)
            else:
                self._note_omission(loop.bodies, "its joints are all driven, or welded")
        return driven, found

    def _replace_motors(self) -> set[int]:
        """Make the joints driven that motors move through transmissions; return all joints of the transmissions."""
        pairs = [(int(self.mj.eq_obj1id[e]), int(self.mj.eq_obj2id[e])) for e in self._equalities(_EQ.mjEQ_JOINT)]
        groups = [{*pair} for pair in pairs if pair[1] >= 0]
        groups += [self._joints_between(*self._ends(e)) for kind in _LOOPS for e in self._equalities(kind)]
        for tendon in range(self.mj.ntendon):
            wraps = slice(self.mj.tendon_adr[tendon], self.mj.tendon_adr[tendon] + self.mj.tendon_num[tendon])
            joints = self.mj.wrap_type[wraps] == mujoco.mjtWrap.mjWRAP_JOINT
            groups.append(set(self.mj.wrap_objid[wraps][joints].tolist()))
        separate: list[set[int]] = []
        for group in groups:
            joined = [each for each in separate if each & group]
            separate = [each for each in separate if not each & group] + [group.union(*joined)]
        found: set[int] = set()
        for group in separate:
            motors = group & self.actuated
            hinges = [j for j in group - motors if j in self.joints and self.mj.jnt_type[j] == _HINGE]
            moved = sorted(hinges, key=self._carried_mass)[len(hinges) - len(motors) :]
            masses = [[self._carried_mass(j) for j in each] for each in (moved, sorted(motors))]
            if motors and len(moved) == len(motors) and min(masses[0]) > _HEAVIER * max(masses[1]):
                self.actuated = (self.actuated - motors) | {*moved}
                found |= group
                names = [", ".join(self.source.joints[j] for j in sorted(each)) for each in (moved, motors)]
                self.source.notes.append(f"{names[0]}: driven directly in place of {names[1]}")
        return found

    def _carried_mass(self, joint: int) -> float:
        """Return the mass beyond a joint [kg]."""
        return float(self.mj.body_subtreemass[self.mj.jnt_bodyid[joint]])

    def _is_held(self, joint: int, looped: set[int]) -> bool:
        """Return whether a spring, damping, friction or a loop brings a joint to rest."""
        dof = int(self.mj.jnt_dofadr[joint])
        held = self.mj.jnt_stiffness[joint] > 0 or self.mj.dof_damping[dof] > 0 or self.mj.dof_frictionloss[dof] > 0
        return bool(held) or joint in looped

    def _note_omission(self, bodies: tuple[int, int], reason: str) -> None:
        one, other = (self.source.bodies[body] for body in bodies)
        self.source.notes.append(f"constraint between {one} and {other} left out: {reason}")

    def _equalities(self, kind: mujoco.mjtEq) -> list[int]:
        return [e for e in range(self.mj.neq) if self.mj.eq_type[e] == kind and self.mj.eq_active0[e]]

    def _softness(self, equality: int) -> str:
        solref, solimp = (" ".join(f"{x:g}" for x in each[equality]) for each in (self.mj.eq_solref, self.mj.eq_solimp))
        return f'solref="{solref}" solimp="{solimp}"'

    def _couplings(self) -> list[Coupling]:
        mj, found = self.mj, []
        for equality in self._equalities(_EQ.mjEQ_JOINT):
            follower, leader = int(mj.eq_obj1id[equality]), int(mj.eq_obj2id[equality])
            if leader < 0 or follower not in self.joints or mj.jnt_type[follower] != _HINGE:
                continue
            source = np.polynomial.Polynomial(mj.eq_data[equality, :5])
            zeros = [float(mj.qpos0[mj.jnt_qposadr[joint]]) for joint in (follower, leader)]
            polynomial = source(np.polynomial.Polynomial([-zeros[1], 1.0])) + zeros[0]
            if follower in self.actuated and leader not in self.actuated and polynomial.degree() == 1:
                offset, slope = map(float, polynomial.coef)
                follower, leader = leader, follower
                polynomial = np.polynomial.Polynomial([-offset / slope, 1 / slope])
            coefficients = np.zeros(5)
            coefficients[: len(polynomial.coef)] = polynomial.coef
            found.append(Coupling(follower, leader, coefficients, self._softness(equality)))
        return found

    def _ends(self, equality: int) -> tuple[int, int]:
        """Return the bodies of a loop."""
        mj, ends = self.mj, (int(self.mj.eq_obj1id[equality]), int(self.mj.eq_obj2id[equality]))
        if mj.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
            return int(mj.site_bodyid[ends[0]]), int(mj.site_bodyid[ends[1]])
        return ends

    def _loops(self) -> list[Loop]:
        mj, data, found = self.mj, self.source.data, []
        for equality in self._equalities(_EQ.mjEQ_CONNECT):
            bodies = self._ends(equality)
            if mj.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
                ends = int(mj.eq_obj1id[equality]), int(mj.eq_obj2id[equality])
                points = data.site_xpos[ends[0]].copy(), data.site_xpos[ends[1]].copy()
            else:
                anchors = mj.eq_data[equality, :3], mj.eq_data[equality, 3:6]
                one, other = (
                    data.xpos[body] + self.source.rotation(body) @ anchor
                    for body, anchor in zip(bodies, anchors, strict=True)
                )
                points = one, other
            if set(bodies) <= self.bodies:
                joints = frozenset(self._joints_between(*bodies))
                found.append(Loop(bodies, points, self._softness(equality), joints))
        for equality in self._equalities(_EQ.mjEQ_WELD):
            self._note_omission(self._ends(equality), "it is a weld")
        return found

    def _joints_between(self, one: int, other: int) -> set[int]:
        return self._joints_to_root(one) ^ self._joints_to_root(other)

    def _joints_to_root(self, body: int) -> set[int]:
        joints = set[int]()
        while body:
            first = int(self.mj.body_jntadr[body])
            joints |= set(range(first, first + int(self.mj.body_jntnum[body])))
            body = int(self.mj.body_parentid[body])
        return joints
