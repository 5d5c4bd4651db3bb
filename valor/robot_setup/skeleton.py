"""Identification of legs, pelvis, waist, chest, arms, hands and neck in a model, by topology and symmetry.

Bodies connected without driven joints form one link. The feet are the two lowest leaves of the tree of links; the
pelvis is in the middle of the path between them; the chest is where the path up from the pelvis branches. Its mirrored
branches are arms, and the one in the middle plane is the neck. Names distinguish left from right only if the feet do
not; if they contradict each other, the user decides.
"""

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from itertools import combinations

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.robot_setup.passive import JointClassifier, PassiveJoints
from valor.robot_setup.source import Question, Source

GROUPS = ("left_leg", "right_leg", "torso", "left_arm", "right_arm", "neck", "left_hand", "right_hand")
LEG_JOINTS = 6
ARM_JOINTS = (3, 7)  # minimum and maximum; joints after these belong to the hand
_CLEAR = 0.05  # distance from ankle to middle of a foot, relative to its length, that indicates forward
_MIDDLE = 0.15  # distance of a link in the middle plane from it, relative to the distance of the farthest branch
_SIDED = re.compile(  # left or right as a word of a name: l_hip, LHipYaw, hipLeft
    r"(?:^|[^a-zA-Z])(?:([lL]eft|LEFT|[lL])|([rR]ight|RIGHT|[rR]))(?=$|[^a-z])"
    r"|(?<=[a-z])(?:(Left|L)|(Right|R))(?=$|[^a-z])"
)

Route = list[tuple[int, tuple[int, ...]]]  # links, each with the joints before it


@dataclass(frozen=True)
class Edge:
    """Connection from a body to a neighbour."""

    to: int
    joints: tuple[int, ...]  # driven ones in the order from body to neighbour
    reversed: bool  # the neighbour is the model's parent; the joints' axes are then inverted
    hinges: tuple[int, ...] = ()  # ``joints`` and passive hinges, in order


@dataclass
class Limb:
    """Chain of driven joints outward from the trunk, the body at its end, and the joints of its fingers."""

    joints: list[int]
    end: int
    fingers: list[int] = field(default_factory=list)


@dataclass
class Skeleton:
    """Roles of a model's bodies and joints."""

    source: Source
    edges: dict[int, list[Edge]]  # body of the robot → its connections
    driven: set[int]
    passive: PassiveJoints
    pelvis: int
    chest: int
    waist: list[int]  # joints from pelvis to chest
    legs: dict[str, Limb]  # by side
    arms: dict[str, Limb]  # by side; empty if there are none
    neck: list[int]  # joints of the branch of the chest in the middle plane
    head: int | None  # body at the neck's end
    others: dict[str, list[int]]  # remaining joints, by the name of their first body
    forward: FloatArray  # (3, 3) axes of the robot as drawn: columns forward, left, up

    def name(self, body: int) -> str:
        """Return the name of a body."""
        return self.source.bodies[body]

    def joint_name(self, joint: int) -> str:
        """Return the name of a joint."""
        return self.source.joints[joint]

    def joint_names(self, joints: Iterable[int]) -> tuple[str, ...]:
        """Return the names of joints."""
        return tuple(map(self.joint_name, joints))

    def link(self, body: int) -> list[int]:
        """Return the bodies connected to a body without driven joints."""
        return self._connected(body, set())

    def rigid(self, body: int) -> list[int]:
        """Return the bodies connected to a body without driven or simulated joints."""
        return self._connected(body, self.passive.simulated)

    def _connected(self, body: int, separating: set[int]) -> list[int]:
        found, waiting = {body}, [body]
        while waiting:
            for edge in self.edges[waiting.pop()]:
                if not edge.joints and edge.to not in found and not separating.intersection(edge.hinges):
                    found.add(edge.to)
                    waiting.append(edge.to)
        return sorted(found)


def find_skeleton(source: Source) -> Skeleton:
    """Identify the roles of bodies and joints. Raises ConfigurationError without two legs of six driven joints."""
    return _Finder(source).find()


def count_left(names: Iterable[str]) -> int:
    """Return how many more names contain left than right."""
    found = [match for name in names if (match := _SIDED.search(name))]
    return sum(1 if match[1] or match[3] else -1 for match in found)


class _Finder:
    def __init__(self, source: Source) -> None:
        self.source, self.mj, self.data = source, source.mj, source.data
        self.root = self._root()
        self.bodies = [b for b in range(1, self.mj.nbody) if self.mj.body_rootid[b] == self.mj.body_rootid[self.root]]
        self.driven, self.passive = JointClassifier(source, self.bodies).classify()
        self._connect_all()

    def _connect_all(self) -> None:
        self.edges: dict[int, list[Edge]] = {body: [] for body in self.bodies}
        self.link: dict[int, int] = {}  # body → first body of its link
        for body in self.bodies:
            self._connect(body, int(self.mj.body_parentid[body]))

    def _weld(self, joints: Collection[int], reason: str) -> Skeleton:
        """Weld driven joints, and find the roles again."""
        self.source.notes.append(f"Welded, {reason}: {self._names(sorted(joints))}")
        self.driven -= set(joints)
        self.passive.weld(joints)
        self._connect_all()
        return self.find()

    def _root(self) -> int:
        """Return the floating body, or the heaviest body fixed to the world."""
        free = [
            int(self.mj.jnt_bodyid[j]) for j in range(self.mj.njnt) if self.mj.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE
        ]
        tops = free or [b for b in range(1, self.mj.nbody) if self.mj.body_parentid[b] == 0]
        if not tops:
            raise self.source.fail("has no bodies; expected a robot")
        return max(tops, key=lambda b: float(self.mj.body_subtreemass[b]))

    def _connect(self, body: int, parent: int) -> None:
        self.link[body] = body
        if parent not in self.edges:
            return
        first, count = int(self.mj.body_jntadr[body]), int(self.mj.body_jntnum[body])
        hinges = tuple(j for j in range(first, first + count) if j in self.driven or j in self.passive.hinges)
        joints = tuple(j for j in hinges if j in self.driven)
        self.edges[parent].append(Edge(body, joints, False, hinges))
        self.edges[body].append(Edge(parent, joints[::-1], True, hinges[::-1]))
        if not joints:
            self.link[body] = self.link[parent]

    def members(self, link: int) -> list[int]:
        """Return the bodies of a link."""
        return [b for b in self.bodies if self.link[b] == link]

    def neighbours(self, link: int, seen: Collection[int] = ()) -> Route:
        """Return the links next to a link, except some, with the joints between."""
        found = [
            (self.link[edge.to], edge.joints) for body in self.members(link) for edge in self.edges[body] if edge.joints
        ]
        return [(to, joints) for to, joints in found if to not in seen]

    def path(self, start: int, end: int, before: int = -1) -> Route:
        """Return the path between two links, both included; empty if it would pass through ``before``."""
        if start == end:
            return [(start, ())]
        for to, joints in self.neighbours(start, {before}):
            if rest := self.path(to, end, start):
                return [(start, ()), (to, joints), *rest[1:]]
        return []

    def lowest(self, link: int) -> float:
        """Return the height of a link's lowest point [m]."""
        bodies = self.members(link)
        heights = [float(self.data.xipos[body][2]) for body in bodies]
        return min(heights + [float(self.source.box_corners(geom)[:, 2].min()) for geom in self.source.geoms(bodies)])

    def find(self) -> Skeleton:
        feet, pelvis = self._feet()
        paths = {foot: self.path(pelvis, foot) for foot in feet}
        joints = {foot: _joints(path) for foot, path in paths.items()}
        if toes := [
            j for each in joints.values() for j in each[LEG_JOINTS:] if self._is_ahead(j, each[LEG_JOINTS - 1])
        ]:
            return self._weld(toes, "as toes beyond the six joints by which a sole can be put in any pose")
        hips = [self.data.xanchor[joints[foot][0]] for foot in feet]
        axes = self._axes(feet, hips, [count_left(self.mj.joint(j).name for j in joints[foot]) for foot in feet])
        if float((hips[0] - hips[1]) @ axes[:, 1]) < 0:
            feet.reverse()
        legs = {side: Limb(joints[foot], self._main(foot)) for side, foot in zip(("left", "right"), feet, strict=True)}
        for side, leg in legs.items():
            if len(leg.joints) != LEG_JOINTS:
                raise self.source.fail(
                    f"the {side} leg has {len(leg.joints)} driven joints ({self._names(leg.joints)}); "
                    "expected six, by which a sole can be put in any pose"
                )
        in_legs = {link for path in paths.values() for link, _ in path}
        waist, chest, below = self._waist(pelvis, in_legs)
        arms, neck, head, others = self._upper(chest, below | in_legs, axes, [leg.joints[0] for leg in legs.values()])
        limbs = [*legs.values(), *arms.values()]
        used = {*waist, *neck, *(j for each in limbs for j in each.joints + each.fingers)}.union(*others.values())
        if left := self.driven - used:
            return self._weld(left, "as branches of pelvis, waist or legs")
        source, pelvis, chest = self.source, self._main(pelvis), self._main(chest)
        return Skeleton(
            source, self.edges, self.driven, self.passive, pelvis, chest, waist, legs, arms, neck, head, others, axes
        )

    def _is_ahead(self, joint: int, ankle: int) -> bool:
        """Return whether a joint is beside or ahead of an ankle, not above or below it."""
        apart = self.data.xanchor[joint] - self.data.xanchor[ankle]
        return bool(np.hypot(apart[0], apart[1]) > abs(apart[2]))

    def _feet(self) -> tuple[list[int], int]:
        """Return the links of the two feet and of the pelvis."""
        links = sorted(set(self.link.values()))
        leaves = [link for link in links if len(self.neighbours(link)) == 1]
        leaves.sort(key=self.lowest)
        best: tuple[float, list[int], int] | None = None
        for one, other in combinations(leaves[:6], 2):
            path = self.path(one, other)
            counts = np.cumsum([len(joints) for _, joints in path])
            middle = [link for (link, _), count in zip(path, counts, strict=True) if 2 * count == counts[-1]]
            if middle and counts[-1] >= 6:
                score = self.lowest(one) + self.lowest(other)
                if best is None or score < best[0] - 1e-6:
                    best = score, [one, other], middle[0]
        if best is None:
            raise self.source.fail(
                "no two legs found; expected two chains with as many driven joints each that meet and end lowest"
            )
        return best[1], best[2]

    def _main(self, link: int) -> int:
        return self.source.heaviest(self.members(link))

    def _names(self, joints: Iterable[int]) -> str:
        return ", ".join(self.source.joints[j] for j in joints)

    def _axes(self, feet: list[int], hips: list[FloatArray], left: list[int]) -> FloatArray:
        """Return forward, left and up as columns: soles extend farther forward of the ankle than backward."""
        up = np.array([0.0, 0.0, 1.0])
        # The nearest axis of the world: models are drawn along x or y, and hips may be slightly off it.
        axis = int(np.argmax(np.abs(np.cross(hips[0] - hips[1], up))))
        reach = length = 0.0
        for foot in feet:
            bodies = self.members(foot)
            corners = [self.source.box_corners(geom) for geom in self.source.geoms(bodies)]
            points = np.concatenate([self.data.xpos[bodies], *corners])[:, axis]
            ankle = float(self.data.xanchor[self.neighbours(foot)[0][1][0]][axis])
            reach += float(points.max() + points.min()) / 2 - ankle
            length += float(np.ptp(points))
        forward = np.zeros(3)
        forward[axis] = 1.0 if reach > -1e-3 else -1.0
        across = float(np.cross(up, forward) @ (hips[0] - hips[1]))
        if left[0] * left[1] < 0 and left[0] * across < 0:
            clear = abs(reach) > _CLEAR * length
            forward = forward if clear and self._trust_feet() else -forward
        return np.stack([forward, np.cross(up, forward), up], axis=1)

    def _trust_feet(self) -> bool:
        """Let the user decide between feet and names where they contradict each other about forward."""
        text = "feet extend one way, but names of left and right imply the other way for forward; follow"
        feet = self.source.ask(Question(text, "feet", ("feet", "names"))) == "feet"
        basis = "where the feet extend" if feet else "given by the names of left and right"
        self.source.notes.append(f"Guessed: forward is {basis}; names and feet contradict each other.")
        return feet

    def _waist(self, pelvis: int, in_legs: set[int]) -> tuple[list[int], int, set[int]]:
        """Return the joints up from the pelvis, the link where the path branches, and the links of the path."""
        joints: list[int] = []
        link, path = pelvis, {pelvis}
        while True:
            onward = self.neighbours(link, in_legs | path)
            if len(onward) != 1 or not self._branches(onward[0][0], path | in_legs):
                return joints, link, path
            link = onward[0][0]
            path.add(link)
            joints += onward[0][1]

    def _branches(self, link: int, before: set[int]) -> bool:
        """Return whether there is a branch at a link or after it; or, at the last link, whether it is heavy."""
        onward = self.neighbours(link, before)
        if not onward:
            return float(self.mj.body_mass[self.members(link)].sum()) > 0.1 * float(self.mj.body_subtreemass[self.root])
        return len(onward) > 1 or self._branches(onward[0][0], before | {link})

    def _upper(
        self, chest: int, before: set[int], axes: FloatArray, hips: list[int]
    ) -> tuple[dict[str, Limb], list[int], int | None, dict[str, list[int]]]:
        """Return arms, neck, head and the other joints above the chest."""
        branches = [self._branch(to, joints, before | {chest}) for to, joints in self.neighbours(chest, before)]
        middle = float(np.mean([self.data.xanchor[joint] @ axes[:, 1] for joint in hips]))

        def lateral(limb: Limb) -> float:
            return float(self.data.xanchor[limb.joints[0]] @ axes[:, 1]) - middle

        near = _MIDDLE * max((abs(lateral(limb)) for limb in branches), default=1.0)
        arms: dict[str, Limb] = {}
        neck: list[int] = []
        head: int | None = None
        others: dict[str, list[int]] = {}
        for limb in sorted(branches, key=lambda each: -len(each.joints) - len(each.fingers)):
            side = "left" if lateral(limb) > 0 else "right"
            if abs(lateral(limb)) > near and len(limb.joints) >= ARM_JOINTS[0] and side not in arms:
                arms[side] = limb
            elif abs(lateral(limb)) <= near and head is None:
                neck, head = limb.joints + limb.fingers, limb.end
            else:
                first = self.source.bodies[int(self.mj.jnt_bodyid[limb.joints[0]])]
                others[self._group(first, limb, others)] = limb.joints + limb.fingers
        if len(arms) == 1:
            side, limb = arms.popitem()
            others[self._group(f"{side}_limb", limb, others)] = limb.joints + limb.fingers
        return arms, neck, head, others

    def _group(self, name: str, limb: Limb, others: Collection[str]) -> str:
        """Return the name of a group for joints of neither arms nor neck."""
        used, joints = (*GROUPS, *others), self._names(limb.joints + limb.fingers)
        name = f"{name}_joints" if name in used else name
        name = self.source.ask(Question(f"neither arm nor neck: {joints}; name of their group", name))
        if name in used:
            raise self.source.fail(f"group {name!r} exists; expected another name for {joints}")
        return name

    def _branch(self, link: int, joints: tuple[int, ...], before: set[int]) -> Limb:
        """Return a chain up to its first branch or the maximum of an arm's joints; later joints are ``fingers``."""
        chain, seen = list(joints), before | {link}
        while len(onward := self.neighbours(link, seen)) == 1 and len(chain) < ARM_JOINTS[1]:
            link = onward[0][0]
            seen.add(link)
            chain += onward[0][1]
        fingers: list[int] = []
        waiting = self.neighbours(link, seen)
        while waiting:
            to, between = waiting.pop(0)
            seen.add(to)
            fingers += between
            waiting += self.neighbours(to, seen)
        return Limb(chain, self._main(link), fingers)


def _joints(path: Route) -> list[int]:
    return [joint for _, joints in path for joint in joints]
