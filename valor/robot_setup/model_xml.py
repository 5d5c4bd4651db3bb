"""``model.xml``: the model anew with the pelvis as its root, its shapes as capsules and soles; what one sees is kept.

Angles keep their meaning: a joint that the pelvis' becoming the root turns around has its axis turned, too.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import escape

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.robot_setup import meshes
from valor.robot_setup.geometry import Capsule, Sole, capsule, cloud, sole, touching_geoms
from valor.robot_setup.skeleton import Edge, Skeleton

_HEAD = """\
<!-- {about} -->
<mujoco model="{name}">
  <compiler angle="radian" autolimits="true" inertiafromgeom="false" meshdir="meshes"/>
  <option timestep="{step:g}" integrator="implicitfast"/>

  <default>
    <default class="visual">
      <geom group="2" contype="0" conaffinity="0"/>
    </default>
    <!-- Bit 0: the world. Bit 1: touches the world only. Bit 2: touches the world and the robot itself. -->
    <default class="body">
      <geom type="capsule" group="3" contype="4" conaffinity="5" condim="3" friction="0.6"/>
    </default>
    <default class="finger">
      <geom type="capsule" group="3" contype="2" conaffinity="1" condim="3" friction="0.9"/>
    </default>
    <default class="sole">
      <geom type="sphere" size="{ball:.4g}" group="3" contype="2" conaffinity="1" condim="3"
            friction="0.9" solref="0.005 1" solimp="0.95 0.99 0.001"/>
    </default>
    <site group="4" size="0.01"/>
  </default>
"""

_PLANE = 0.03  # of a sole's length: what is so near to its plane stands on the ground with it
_BALL = 0.01  # ESCHER's [m]
_HIDDEN = 3  # group of geoms from which on MuJoCo's viewers show none


@dataclass
class Parts:
    """What is drawn on the skeleton.

    Attributes:
        soles: by side, in the world as drawn.
        palms: (3,) by side, where hand goals refer to, in the world as drawn [m].
        pads: by body, what else of a foot stands on the ground, on hinges that nothing drives.
        capsules: by body, in the body's own frame.
        excluded: pairs of bodies' names that overlap at rest and are not kept apart.
        step: of the physics [s].
    """

    soles: dict[str, Sole]
    palms: dict[str, FloatArray]
    pads: dict[int, Sole]
    capsules: dict[int, Capsule]
    excluded: list[tuple[str, str]] = field(default_factory=list)
    step: float = 0.001

    @property
    def ball(self) -> float:
        """Radius of a sole's corners [m]. Much smaller ones catch on the edges between a height field's cells."""
        return min(_BALL, 0.5 * min(sole.half_width for sole in self.soles.values()))


def link(robot: Skeleton, body: int) -> list[int]:
    """The bodies that no driven joint parts from one."""
    return _joined(robot, body, set())


def rigid(robot: Skeleton, body: int) -> list[int]:
    """The bodies that no joint that moves parts from one."""
    return _joined(robot, body, robot.passive.simulated)


def _joined(robot: Skeleton, body: int, parting: set[int]) -> list[int]:
    found, waiting = {body}, [body]
    while waiting:
        for edge in robot.edges[waiting.pop()]:
            if not edge.joints and edge.to not in found and not parting.intersection(edge.hinges):
                found.add(edge.to)
                waiting.append(edge.to)
    return sorted(found)


def fit(robot: Skeleton, soles: dict[str, Sole], palms: dict[str, FloatArray]) -> Parts:
    """Capsules for all that has a shape."""
    source, mj = robot.source, robot.source.mj
    feet = {robot.legs[side].end: side for side in robot.legs}
    capsules: dict[int, Capsule] = {}
    pads: dict[int, Sole] = {}
    seen: set[int] = set()
    for body in sorted(robot.edges):
        if body in seen:
            continue
        bodies = rigid(robot, body)
        seen |= set(bodies)
        main = max(bodies, key=lambda each: float(mj.body_mass[each]))
        if foot := next((each for each in bodies if each in feet), None):
            capsules[foot] = _foot_capsule(robot, foot, soles[feet[foot]])
        elif pad := _pad(robot, bodies, soles):
            pads[main] = pad
        elif len(points := cloud(source, bodies)) > 3:
            capsules[main] = capsule((points - source.data.xpos[main]) @ source.rotation(main))
    return Parts(soles, palms, pads, capsules)


def _pad(robot: Skeleton, bodies: list[int], soles: dict[str, Sole]) -> Sole | None:
    """The underside of a part of a foot, if it is in the plane of the foot's sole."""
    for side, leg in robot.legs.items():
        if bodies[0] in link(robot, leg.end):
            found, own = sole(cloud(robot.source, bodies), soles[side].origin, robot.forward), soles[side]
            if found and abs(own.rotation[:, 2] @ (found.origin - own.origin)) < _PLANE * (own.toe - own.heel):
                return found
    return None


def _foot_capsule(robot: Skeleton, foot: int, sole: Sole) -> Capsule:
    """Along the foot, a little above its sole, which alone shall touch the ground."""
    source = robot.source
    radius = min(sole.half_width, (sole.toe - sole.heel) / 4) * 0.7
    ends = [
        sole.origin + sole.rotation @ np.array([x, 0.0, 1.3 * radius]) for x in (sole.heel + radius, sole.toe - radius)
    ]
    start, end = ((each - source.data.xpos[foot]) @ source.rotation(foot) for each in ends)
    return Capsule(start, end, radius)


def write(robot: Skeleton, parts: Parts, name: str, folder: Path, size: float) -> None:
    """Write ``model.xml`` and the meshes that it shows, of a robot whose leg is so long [m], into a folder."""
    writer = _Writer(robot, parts, shown=True)
    (folder / "model.xml").write_text(_text(writer, name))
    meshes.write(robot.source.mj, writer.meshes, folder / "meshes", size)


def text(robot: Skeleton, parts: Parts, name: str) -> str:
    """``model.xml`` with what touches alone, which needs no meshes."""
    return _text(_Writer(robot, parts, shown=False), name)


def _text(writer: _Writer, name: str) -> str:
    robot, parts = writer.robot, writer.parts
    body = "\n".join(writer.body(robot.pelvis, None, None, 2))
    about = (
        f"{name}, out of {robot.source.file.name}: what each part weighs and where joints turn is the maker's; "
        "the shapes that touch are fitted. Limits, armature, damping and gains stand in robot.yaml. Units: m, kg, rad."
    )
    head = _HEAD.format(about=escape(about).replace("--", "-"), name=escape(name), step=parts.step, ball=parts.ball)
    assets = "".join(
        f'    <mesh name="{mesh}" file="{mesh}.stl" inertia="shell"/>\n' for mesh in sorted(writer.meshes.values())
    )
    contact = "".join(f'    <exclude body1="{a}" body2="{b}"/>\n' for a, b in parts.excluded)
    made = f"{head}\n  <asset>\n{assets}  </asset>\n\n  <worldbody>\n{body}\n  </worldbody>\n"
    couplings = "".join(f"    {line}\n" for line in writer.equalities())
    made += f"\n  <equality>\n{couplings}  </equality>\n" if couplings else ""
    made += f"\n  <!-- Fitted shapes that overlap at rest. -->\n  <contact>\n{contact}  </contact>\n" if contact else ""
    return made + "</mujoco>\n"


class _Writer:
    def __init__(self, robot: Skeleton, parts: Parts, shown: bool) -> None:
        self.robot, self.parts, self.shown = robot, parts, shown
        self.source, self.mj, self.data = robot.source, robot.source.mj, robot.source.data
        self.meshes: dict[int, str] = {}  # shown, by id
        self.names = set(self.source.bodies)
        self.feet = {leg.end: side for side, leg in robot.legs.items()}
        self.hands = {arm.end: side for side, arm in robot.arms.items()}
        fingers = {int(self.mj.jnt_bodyid[j]) for arm in robot.arms.values() for j in arm.beyond}
        self.fingers = {each for body in fingers for each in link(robot, body)}

    def frame(self, body: int) -> tuple[FloatArray, FloatArray]:
        """(3,) and (3, 3): the pelvis looks forward, whatever its own axes; the others keep theirs."""
        rotation = self.robot.forward if body == self.robot.pelvis else self.source.rotation(body)
        return self.data.xpos[body], rotation

    def body(self, body: int, before: int | None, edge: Edge | None, depth: int) -> Iterator[str]:
        """The lines of a body and all that hangs from it."""
        mj, pad = self.mj, "  " * depth
        here, rotation = self.frame(body)
        placed = ""
        if before is not None:
            there, parent = self.frame(before)
            placed = _pose(parent.T @ (here - there), parent.T @ rotation)
        joints = list(self.joints(edge, here, rotation)) if edge else []
        for joint in joints[:-1]:  # a body of the generated model has one joint: URDF knows no more
            yield f'{pad}<body name="{self.between(body)}"{placed}>'
            yield f'{pad}  <inertial mass="1e-06" pos="0 0 0" diaginertia="1e-09 1e-09 1e-09"/>'
            yield f"{pad}  {joint}"
            pad, placed = pad + "  ", ""
        yield f'{pad}<body name="{escape(self.robot.name(body))}"{placed}>'
        inside = pad + "  "
        turned = np.zeros(4)
        mujoco.mju_mat2Quat(turned, (rotation.T @ self.source.rotation(body)).flatten())
        centre, own = np.zeros(3), np.zeros(4)
        mujoco.mju_rotVecQuat(centre, mj.body_ipos[body], turned)
        mujoco.mju_mulQuat(own, turned, mj.body_iquat[body])
        if mj.body_mass[body] > 0:
            numbers = _numbers(np.maximum(mj.body_inertia[body], 1e-9))
            place = f'pos="{_numbers(centre)}"' + ("" if abs(own[0]) > 1 - 1e-9 else f' quat="{_numbers(own)}"')
            yield f'{inside}<inertial mass="{mj.body_mass[body]:.6g}" {place} diaginertia="{numbers}"/>'
        if before is None:
            yield f'{inside}<freejoint name="floating_base"/>'
        if joints:
            yield inside + joints[-1]
        yield from (inside + line for line in self.shapes(body, here, rotation))
        for onward in self.robot.edges[body]:
            if onward.to != before:
                yield from self.body(onward.to, body, onward, depth + 1)
        yield f"{pad}</body>"
        for _ in joints[:-1]:
            pad = pad[2:]
            yield f"{pad}</body>"

    def between(self, body: int) -> str:
        """A name for one more body before a body."""
        number = 1
        while (name := f"{self.robot.name(body)}_{number}") in self.names:
            number += 1
        self.names.add(name)
        return name

    def joints(self, edge: Edge, here: FloatArray, rotation: FloatArray) -> Iterator[str]:
        """Those on the way to a body, in its frame."""
        for joint in edge.hinges:
            anchor = rotation.T @ (self.data.xanchor[joint] - here)
            axis = rotation.T @ self.data.xaxis[joint] * (-1 if edge.reversed else 1)
            at = "" if np.linalg.norm(anchor) < 1e-6 else f' pos="{_numbers(anchor)}"'
            own = "" if joint in self.robot.driven else self.own(joint)
            yield f'<joint name="{escape(self.robot.joint_name(joint))}"{at} axis="{_numbers(axis)}"{own}/>'

    def own(self, joint: int) -> str:
        """What a joint that nothing drives has of itself."""
        mj, dof = self.mj, int(self.mj.jnt_dofadr[joint])
        told = {
            "stiffness": float(mj.jnt_stiffness[joint]),
            "springref": float(mj.qpos_spring[mj.jnt_qposadr[joint]]) if mj.jnt_stiffness[joint] else 0.0,
            "damping": float(mj.dof_damping[dof]),
            "armature": float(mj.dof_armature[dof]),
            "frictionloss": float(mj.dof_frictionloss[dof]),
        }
        limited = f' range="{_numbers(mj.jnt_range[joint])}"' if mj.jnt_limited[joint] else ""
        return limited + "".join(f' {key}="{value:.6g}"' for key, value in told.items() if value)

    def equalities(self) -> Iterator[str]:
        """What couples joints and closes loops."""
        passive, name = self.robot.passive, self.robot.joint_name
        for each in passive.couplings:
            if each.follower in passive.simulated and each.leader in self.robot.driven | passive.simulated:
                ends = f'joint1="{escape(name(each.follower))}" joint2="{escape(name(each.leader))}"'
                yield f'<joint {ends} polycoef="{_numbers(each.polynomial)}" {each.softness}/>'
        for number, loop in enumerate(passive.loops, 1):
            yield f'<connect site1="joint_{number}_a" site2="joint_{number}_b" {loop.softness}/>'

    def shapes(self, body: int, here: FloatArray, rotation: FloatArray) -> Iterator[str]:
        """Sites and geoms of a body."""
        if body == self.robot.pelvis:
            yield '<site name="imu"/>'
        if side := self.feet.get(body):
            own_sole = self.parts.soles[side]
            local = rotation.T @ (own_sole.origin - here)
            yield f'<site name="{side[0]}_sole"{_pose(local, rotation.T @ own_sole.rotation)}/>'
            yield from self.corners(own_sole, here, rotation)
        if side := self.hands.get(body):
            palm = _pose(rotation.T @ (self.parts.palms[side] - here), rotation.T @ self.robot.forward)
            yield f'<site name="{side[0]}_gripper"{palm}/>'
        for number, loop in enumerate(self.robot.passive.loops, 1):
            for end, letter in enumerate("ab"):
                if loop.bodies[end] == body:
                    at = _pose(rotation.T @ (loop.points[end] - here), np.eye(3))
                    yield f'<site name="joint_{number}_{letter}"{at}/>'
        if pad := self.parts.pads.get(body):
            yield from self.corners(pad, here, rotation)
        if shape := self.parts.capsules.get(body):
            own = rotation.T @ self.source.rotation(body)
            kind = "finger" if body in self.fingers else "body"
            ends = _numbers([*own @ shape.start, *own @ shape.end])
            yield f'<geom class="{kind}" size="{shape.radius:.4g}" fromto="{ends}"/>'
        if self.shown:
            yield from self.seen(body, here, rotation)

    def corners(self, sole: Sole, here: FloatArray, rotation: FloatArray) -> Iterator[str]:
        """What a sole stands on."""
        for x in (sole.heel, sole.toe):
            for y in (-sole.half_width, sole.half_width):
                corner = sole.origin + sole.rotation @ np.array([x, y, self.parts.ball]) - here
                yield f'<geom class="sole" pos="{_numbers(rotation.T @ corner)}"/>'

    def seen(self, body: int, here: FloatArray, rotation: FloatArray) -> Iterator[str]:
        """What one sees of a body: what does not collide, else what does."""
        mj = self.mj
        mine = range(mj.body_geomadr[body], mj.body_geomadr[body] + mj.body_geomnum[body])
        shown = [g for g in mine if mj.geom_group[g] < _HIDDEN and mj.geom_rgba[g][3] > 0]
        bare = [g for g in shown if not (mj.geom_contype[g] or mj.geom_conaffinity[g])]
        for geom in bare or shown or mine:
            pose = _pose(
                rotation.T @ (self.data.geom_xpos[geom] - here), rotation.T @ self.data.geom_xmat[geom].reshape(3, 3)
            )
            material = mj.geom_matid[geom]
            colour = mj.mat_rgba[material] if material >= 0 else mj.geom_rgba[geom]
            look = f'class="visual" rgba="{_numbers(colour[:3])} 1"{pose}'
            if mj.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
                yield f'<geom {look} type="mesh" mesh="{self.mesh(int(mj.geom_dataid[geom]))}"/>'
            else:
                kind = mujoco.mjtGeom(int(mj.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
                yield f'<geom {look} type="{kind}" size="{_numbers(mj.geom_size[geom])}"/>'

    def mesh(self, mesh: int) -> str:
        """The name of a mesh that is shown."""
        if mesh not in self.meshes:
            name = re.sub(r"\W+", "_", self.mj.mesh(mesh).name or "mesh")
            self.meshes[mesh] = f"{name}_{mesh}" if name in self.meshes.values() else name
        return self.meshes[mesh]


def has_shape(robot: Skeleton, body: int) -> bool:
    """Whether something of a body's link can touch."""
    return bool(touching_geoms(robot.source, link(robot, body)))


def _pose(position: FloatArray, rotation: FloatArray) -> str:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).flatten())
    place = "" if np.linalg.norm(position) < 1e-9 else f' pos="{_numbers(position)}"'
    return place + ("" if abs(quaternion[0]) > 1 - 1e-9 else f' quat="{_numbers(quaternion)}"')


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{0.0 if abs(value) < 5e-8 else value:.7g}" for value in values)
