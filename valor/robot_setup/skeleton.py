"""Which links and joints of a model are legs, pelvis, waist, chest, arms, hands and neck: by topology and symmetry.

Bodies that no driven joint parts are one link. The feet are the two leaves of the tree of links that reach lowest; the
pelvis is in the middle of the way between them, whichever link the model's root is; the chest is where the way up from
the pelvis branches; of what hangs from it, what has a twin on the other side is an arm, and what stands in the middle
plane is the neck. Names are looked at for the two sides only: they say which is left where the feet do not, and where
they contradict the feet somebody is asked.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field
from itertools import combinations

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.robot_setup.passive import Passive, sort_joints
from valor.robot_setup.questions import Ask, Question, guess
from valor.robot_setup.sides import feet_are_right, said_left
from valor.robot_setup.source import Source

GROUPS = ("left_leg", "right_leg", "torso", "left_arm", "right_arm", "neck", "left_hand", "right_hand")
LEG_JOINTS = 6
ARM_JOINTS = (3, 7)  # fewest, and most: what lies beyond is the hand's
_CLEAR = 0.05  # of a foot's length, from its ankle to its middle: then it says where forward is
_MIDDLE = 0.15  # of the feet's distance: a link that is nearer to the middle plane stands in it


@dataclass(frozen=True)
class Edge:
    """Driven joints between two bodies as one walks from one to the other: in that order, none where they are fixed.

    ``reversed`` where the model has the edge the other way around: the joints' axes are turned then. ``hinges`` are the
    joints with those among them that nothing drives.
    """

    to: int
    joints: tuple[int, ...]
    reversed: bool
    hinges: tuple[int, ...] = ()


@dataclass
class Limb:
    """A chain of driven joints from the trunk out, and the body at its end."""

    joints: list[int]
    end: int
    beyond: list[int] = field(default_factory=list)  # driven joints farther out, of fingers


@dataclass
class Skeleton:
    """The roles of a model's bodies and joints.

    Attributes:
        source: the model.
        edges: of each body of the robot, those to its neighbours.
        driven: ids of the joints that something drives.
        passive: what nothing drives.
        pelvis, chest: bodies.
        waist: joints from pelvis to chest.
        legs, arms: by side; no arms: empty.
        neck: joints of what stands on the chest in the middle plane.
        head: the body at the neck's end, or None.
        others: joints that are none of all these, by the name of the body that they begin with.
        forward: (3, 3) the robot's axes in the world as drawn: columns forward, left, up.
    """

    source: Source
    edges: dict[int, list[Edge]]
    driven: set[int]
    passive: Passive
    pelvis: int
    chest: int
    waist: list[int]
    legs: dict[str, Limb]
    arms: dict[str, Limb]
    neck: list[int]
    head: int | None
    others: dict[str, list[int]]
    forward: FloatArray

    def name(self, body: int) -> str:
        """Of a body."""
        return self.source.bodies[body]

    def joint_name(self, joint: int) -> str:
        """Of a joint."""
        return self.source.joints[joint]


def skeleton(source: Source, ask: Ask = guess) -> Skeleton:
    """Find the roles.

    Args:
        source: the model.
        ask: for what cannot be seen.

    Raises:
        ConfigurationError: the model is no humanoid with six driven joints a leg, as far as can be seen.
    """
    return _Finder(source, ask).find()


class _Finder:
    def __init__(self, source: Source, ask: Ask) -> None:
        self.source, self.mj, self.data, self.ask = source, source.mj, source.data, ask
        self.root = self._root()
        self.bodies = [b for b in range(1, self.mj.nbody) if self.mj.body_rootid[b] == self.mj.body_rootid[self.root]]
        self.driven, self.passive = sort_joints(source, self.bodies, ask)
        self.edges = self._edges()
        self.link = self._links()

    def fail(self, what: str) -> ConfigurationError:
        return ConfigurationError(f"{self.source.file}: {what}")

    def _root(self) -> int:
        """The body that floats; else the heaviest that stands in the world."""
        free = [
            int(self.mj.jnt_bodyid[j]) for j in range(self.mj.njnt) if self.mj.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE
        ]
        tops = free or [b for b in range(1, self.mj.nbody) if self.mj.body_parentid[b] == 0]
        if not tops:
            raise self.fail("has no bodies; expected a robot")
        return max(tops, key=lambda b: float(self.mj.body_subtreemass[b]))

    def _edges(self) -> dict[int, list[Edge]]:
        edges: dict[int, list[Edge]] = {body: [] for body in self.bodies}
        for body in self.bodies:
            parent = int(self.mj.body_parentid[body])
            if parent not in edges:
                continue
            first, count = int(self.mj.body_jntadr[body]), int(self.mj.body_jntnum[body])
            hinges = tuple(j for j in range(first, first + count) if j in self.driven or j in self.passive.hinges)
            joints = tuple(j for j in hinges if j in self.driven)
            edges[parent].append(Edge(body, joints, False, hinges))
            edges[body].append(Edge(parent, joints[::-1], True, hinges[::-1]))
        return edges

    def _links(self) -> dict[int, int]:
        """Body → the first body of its link."""
        link: dict[int, int] = {}
        for start in self.bodies:
            if start in link:
                continue
            waiting = [start]
            while waiting:
                body = waiting.pop()
                link[body] = start
                waiting += [e.to for e in self.edges[body] if not e.joints and e.to not in link]
        return link

    def members(self, body: int) -> list[int]:
        """The bodies of a body's link."""
        return [b for b in self.bodies if self.link[b] == self.link[body]]

    def neighbours(self, link: int) -> list[tuple[int, tuple[int, ...], int]]:
        """Of a link: (link, joints on the way, body there)."""
        return [
            (self.link[edge.to], edge.joints, edge.to)
            for body in self.members(link)
            for edge in self.edges[body]
            if edge.joints
        ]

    def way(self, start: int, end: int) -> list[tuple[int, tuple[int, ...]]]:
        """Links from one to another with the joints that lead to each; the first has none."""
        before: dict[int, tuple[int, tuple[int, ...]] | None] = {start: None}
        waiting = deque([start])
        while waiting:
            link = waiting.popleft()
            for to, joints, _ in self.neighbours(link):
                if to not in before:
                    before[to] = (link, joints)
                    waiting.append(to)
        steps: list[tuple[int, tuple[int, ...]]] = []
        link = end
        while (step := before[link]) is not None:
            steps.append((link, step[1]))
            link = step[0]
        return [(start, ()), *reversed(steps)]

    def lowest(self, link: int) -> float:
        """Height of the lowest point of a link [m]."""
        heights = []
        for body in self.members(link):
            heights.append(float(self.data.xipos[body][2]))
            first, count = self.mj.body_geomadr[body], self.mj.body_geomnum[body]
            for geom in range(first, first + count):
                centre, half = self.mj.geom_aabb[geom, :3], self.mj.geom_aabb[geom, 3:]
                rotation = self.data.geom_xmat[geom].reshape(3, 3)
                heights.append(float((self.data.geom_xpos[geom] + rotation @ centre)[2] - np.abs(rotation[2]) @ half))
        return min(heights)

    def find(self) -> Skeleton:
        feet, pelvis = self._feet()
        pelvis_body = self._main(pelvis)
        ways = {foot: self.way(pelvis, foot) for foot in feet}
        hips = [self.data.xanchor[next(j for _, joints in ways[foot] for j in joints)] for foot in feet]
        said = [said_left(self.mj.joint(j).name for _, joints in ways[foot] for j in joints) for foot in feet]
        axes = self._axes(feet, hips, said)
        if float((hips[0] - hips[1]) @ axes[:, 1]) < 0:
            feet.reverse()
        legs = {side: self._limb(ways[foot], foot) for side, foot in zip(("left", "right"), feet, strict=True)}
        for side, leg in legs.items():
            if len(leg.joints) != LEG_JOINTS:
                names = ", ".join(self.source.joints[j] for j in leg.joints)
                raise self.fail(
                    f"the {side} leg has {len(leg.joints)} driven joints ({names}); "
                    "expected six, by which a sole can be put in any pose"
                )
        taken = {link for foot in feet for link, _ in ways[foot]}
        waist, chest, before = self._waist(pelvis, taken)
        arms, neck, head, others = self._upper(chest, before | taken, axes, [leg.joints[0] for leg in legs.values()])
        return Skeleton(
            self.source,
            self.edges,
            self.driven,
            self.passive,
            pelvis_body,
            self._main(chest),
            waist,
            legs,
            arms,
            neck,
            head,
            others,
            axes,
        )

    def _feet(self) -> tuple[list[int], int]:
        """The two feet's links, and the pelvis'."""
        links = sorted(set(self.link.values()))
        leaves = [link for link in links if len(self.neighbours(link)) == 1]
        leaves.sort(key=self.lowest)
        best: tuple[float, list[int], int] | None = None
        for one, other in combinations(leaves[:6], 2):
            way = self.way(one, other)
            counts = np.cumsum([len(joints) for _, joints in way])
            middle = [link for (link, _), count in zip(way, counts, strict=True) if 2 * count == counts[-1]]
            if middle and counts[-1] >= 6:
                score = self.lowest(one) + self.lowest(other)
                if best is None or score < best[0] - 1e-6:
                    best = score, [one, other], middle[0]
        if best is None:
            raise self.fail("no two legs found: no two chains with as many driven joints that meet and end lowest")
        return best[1], best[2]

    def _main(self, link: int) -> int:
        """A link's heaviest body."""
        return max((b for b in self.bodies if self.link[b] == link), key=lambda b: float(self.mj.body_mass[b]))

    def _axes(self, feet: list[int], hips: list[FloatArray], said: list[int]) -> FloatArray:
        """(3, 3) forward, left, up. The lateral axis goes through the hips; soles reach farther forward than back."""
        lateral = hips[0] - hips[1]
        lateral[2] = 0.0
        lateral /= np.linalg.norm(lateral)
        up = np.array([0.0, 0.0, 1.0])
        forward = np.cross(lateral, up)
        # The axis of the world that is nearest: models are drawn along x or y, and hips may lie a little beside them.
        nearest = np.zeros(3)
        nearest[int(np.argmax(np.abs(forward)))] = 1.0
        reach = length = 0.0
        for foot in feet:
            points = self._extent(foot) @ nearest
            onward = self.way(foot, self.link[self.root])
            ankle = float(self.data.xanchor[onward[1][1][0]] @ nearest) if len(onward) > 1 else 0.0
            reach += float(points.max() + points.min()) / 2 - ankle
            length += float(np.ptp(points))
        forward = nearest * (1.0 if reach > -1e-3 else -1.0)
        across = float(np.cross(up, forward) @ (hips[0] - hips[1]))
        if said[0] * said[1] < 0 and said[0] * across < 0:
            clear = abs(reach) > _CLEAR * length
            forward = forward if clear and feet_are_right(self.source, self.ask) else -forward
        return np.stack([forward, np.cross(up, forward), up], axis=1)

    def _extent(self, link: int) -> FloatArray:
        """(k, 3) corners of a link's geoms' boxes, as drawn [m]."""
        points = [self.data.xpos[b] for b in self.bodies if self.link[b] == link]
        for body in self.members(link):
            first, count = self.mj.body_geomadr[body], self.mj.body_geomnum[body]
            for geom in range(first, first + count):
                signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
                corners = self.mj.geom_aabb[geom, :3] + signs * self.mj.geom_aabb[geom, 3:]
                points += list(self.data.geom_xpos[geom] + corners @ self.data.geom_xmat[geom].reshape(3, 3).T)
        return np.array(points)

    def _limb(self, way: list[tuple[int, tuple[int, ...]]], end: int) -> Limb:
        return Limb([joint for _, joints in way for joint in joints], self._main(end))

    def _waist(self, pelvis: int, taken: set[int]) -> tuple[list[int], int, set[int]]:
        """Joints up from the pelvis, the link where the way branches, and the links on the way."""
        joints: list[int] = []
        link, on_way = pelvis, {pelvis}
        while True:
            onward = [(to, between) for to, between, _ in self.neighbours(link) if to not in taken | on_way]
            if len(onward) != 1 or not self._branches(onward[0][0], on_way | taken):
                return joints, link, on_way
            link = onward[0][0]
            on_way.add(link)
            joints += onward[0][1]

    def _branches(self, link: int, before: set[int]) -> bool:
        """Whether a link, or what lies beyond it, has more than one branch; or all ends there."""
        onward = [to for to, _, _ in self.neighbours(link) if to not in before]
        if not onward:
            return float(self.mj.body_mass[self.members(link)].sum()) > 0.1 * float(self.mj.body_subtreemass[self.root])
        return len(onward) > 1 or self._branches(onward[0], before | {link})

    def _upper(
        self, chest: int, before: set[int], axes: FloatArray, hips: list[int]
    ) -> tuple[dict[str, Limb], list[int], int | None, dict[str, list[int]]]:
        """Arms, neck, head and what else is on the chest."""
        branches = [
            self._branch(to, between, before | {chest}) for to, between, _ in self.neighbours(chest) if to not in before
        ]
        middle = float(np.mean([self.data.xanchor[joint] @ axes[:, 1] for joint in hips]))
        scale = (
            max(abs(float((self.data.xanchor[limb.joints[0]] @ axes[:, 1]) - middle)) for limb in branches)
            if branches
            else 1.0
        )
        arms: dict[str, Limb] = {}
        neck: list[int] = []
        head: int | None = None
        others: dict[str, list[int]] = {}
        for limb in sorted(branches, key=lambda each: -len(each.joints) - len(each.beyond)):
            lateral = float(self.data.xanchor[limb.joints[0]] @ axes[:, 1]) - middle
            side = "left" if lateral > 0 else "right"
            if abs(lateral) > _MIDDLE * scale and len(limb.joints) >= ARM_JOINTS[0] and side not in arms:
                arms[side] = limb
            elif abs(lateral) <= _MIDDLE * scale and head is None:
                neck, head = limb.joints + limb.beyond, limb.end
            else:
                first = self.source.bodies[int(self.mj.jnt_bodyid[limb.joints[0]])]
                others[self._group(first, limb, others)] = limb.joints + limb.beyond
        if len(arms) == 1:
            side, limb = arms.popitem()
            others[self._group(f"{side}_limb", limb, others)] = limb.joints + limb.beyond
        return arms, neck, head, others

    def _group(self, wanted: str, limb: Limb, others: Collection[str]) -> str:
        """A name for joints that are of neither arms nor neck."""
        taken, joints = (*GROUPS, *others), ", ".join(self.source.joints[j] for j in limb.joints + limb.beyond)
        wanted = f"{wanted}_joints" if wanted in taken else wanted
        name = self.ask(Question(f"neither arm nor neck: {joints}; the name of their group", wanted))
        if name in taken:
            raise self.fail(f"group {name!r} is there already; expected another name for {joints}")
        return name

    def _branch(self, link: int, joints: tuple[int, ...], before: set[int]) -> Limb:
        """A chain up to where it branches or has as many joints as an arm has; the rest lies beyond."""
        chain, seen = list(joints), before | {link}
        while True:
            onward = [(to, between) for to, between, _ in self.neighbours(link) if to not in seen]
            if len(onward) != 1 or len(chain) >= ARM_JOINTS[1]:
                break
            link = onward[0][0]
            seen.add(link)
            chain += onward[0][1]
        beyond: list[int] = []
        waiting = [(to, between) for to, between, _ in self.neighbours(link) if to not in seen]
        while waiting:
            to, between = waiting.pop(0)
            seen.add(to)
            beyond += between
            waiting += [(on, also) for on, also, _ in self.neighbours(to) if on not in seen]
        return Limb(chain, self._main(link), beyond)
