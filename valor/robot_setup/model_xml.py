"""Generation of ``model.xml`` and its meshes; axes of joints that the new root reverses are inverted."""

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from xml.sax.saxutils import escape

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.robot_setup.geometry import ModelGeometry, Sole
from valor.robot_setup.meshes import Faces, Triangles, stl
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

_HIDDEN = 3  # first group of geoms that MuJoCo's viewers hide
_MOST_FACES = 120_000  # maximum of a robot's meshes: 6 MB
_CELL = 0.003  # initial cell of the vertex grid for a leg of 1 m [m]
_COARSER = 1.5  # factor for the cell while there are too many faces
_FEW_FACES = 300  # a mesh with at most so many stays as it is


def write(robot: Skeleton, geometry: ModelGeometry, name: str, folder: Path, leg: float) -> None:
    """Write ``model.xml`` and its visible meshes to a folder; ``leg`` is the leg's length [m]."""
    writer = _Writer(robot, geometry, visible=True)
    (folder / "model.xml").write_text(writer.document(name))
    _write_meshes(robot.source.mj, writer.meshes, folder / "meshes", leg)


def render(robot: Skeleton, geometry: ModelGeometry, name: str) -> str:
    """Return ``model.xml`` without visible geoms; it needs no meshes."""
    return _Writer(robot, geometry, visible=False).document(name)


class _Writer:
    def __init__(self, robot: Skeleton, geometry: ModelGeometry, visible: bool) -> None:
        self.robot, self.geometry, self.visible = robot, geometry, visible
        self.source, self.mj, self.data = robot.source, robot.source.mj, robot.source.data
        self.meshes: dict[int, str] = {}  # visible ones: id → name
        self.names = set(self.source.bodies)
        self.feet = {leg.end: side for side, leg in robot.legs.items()}
        self.hands = {arm.end: side for side, arm in robot.arms.items()}
        fingers = {int(self.mj.jnt_bodyid[j]) for arm in robot.arms.values() for j in arm.fingers}
        self.fingers = {each for body in fingers for each in robot.link(body)}

    def document(self, name: str) -> str:
        robot, geometry = self.robot, self.geometry
        body = "\n".join(self.body(robot.pelvis, None, None, 2))
        about = (
            f"{name}, from {robot.source.file.name}: masses, inertias and joint positions are the maker's; colliding "
            "shapes are fitted. robot.yaml has limits, armature, damping and gains. Units: m, kg, rad."
        )
        parts = [
            _HEAD.format(
                about=escape(about).replace("--", "-"), name=escape(name), step=geometry.step, ball=geometry.ball
            ),
            "  <asset>",
            *(f'    <mesh name="{mesh}" file="{mesh}.stl" inertia="shell"/>' for mesh in sorted(self.meshes.values())),
            "  </asset>\n",
            f"  <worldbody>\n{body}\n  </worldbody>",
        ]
        if couplings := [f"    {line}" for line in self.equalities()]:
            parts += ["\n  <equality>", *couplings, "  </equality>"]
        if geometry.excluded:
            excluded = (f'    <exclude body1="{a}" body2="{b}"/>' for a, b in geometry.excluded)
            parts += ["\n  <!-- Fitted shapes that overlap at rest. -->\n  <contact>", *excluded, "  </contact>"]
        return "\n".join([*parts, "</mujoco>\n"])

    def frame(self, body: int) -> tuple[FloatArray, FloatArray]:
        """Return a body's position (3,) and axes (3, 3) as drawn: forward for the pelvis, the maker's for others."""
        rotation = self.robot.forward if body == self.robot.pelvis else self.source.rotation(body)
        return self.data.xpos[body], rotation

    def body(self, body: int, before: int | None, edge: Edge | None, depth: int) -> Iterator[str]:
        """Yield the lines of a body and its descendants."""
        mj, pad = self.mj, "  " * depth
        here, rotation = self.frame(body)
        placed = ""
        if before is not None:
            there, parent = self.frame(before)
            placed = _pose(parent.T @ (here - there), parent.T @ rotation)
        joints = list(self.joints(edge, here, rotation)) if edge else []
        for joint in joints[:-1]:  # one joint per body of the generated model, as in URDF
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
            inertia = np.maximum(mj.body_inertia[body], 1e-9)
            # Rounding must not make the largest more than the sum of the others.
            numbers = " ".join(f"{x:.7g}" for x in np.minimum(inertia, (1 - 1e-6) * (inertia.sum() - inertia)))
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
        """Return the name of an additional body before a body."""
        number = 1
        while (name := f"{self.robot.name(body)}_{number}") in self.names:
            number += 1
        self.names.add(name)
        return name

    def joints(self, edge: Edge, here: FloatArray, rotation: FloatArray) -> Iterator[str]:
        """Yield the joints of an edge to a body, in the body's frame."""
        for joint in edge.hinges:
            anchor = rotation.T @ (self.data.xanchor[joint] - here)
            axis = rotation.T @ self.data.xaxis[joint] * (-1 if edge.reversed else 1)
            at = "" if np.linalg.norm(anchor) < 1e-6 else f' pos="{_numbers(anchor)}"'
            own = "" if joint in self.robot.driven else self.dynamics(joint)
            yield f'<joint name="{escape(self.robot.joint_name(joint))}"{at} axis="{_numbers(axis)}"{own}/>'

    def dynamics(self, joint: int) -> str:
        """Return the attributes of a passive joint."""
        mj, dof = self.mj, int(self.mj.jnt_dofadr[joint])
        values = {
            "stiffness": float(mj.jnt_stiffness[joint]),
            "springref": float(mj.qpos_spring[mj.jnt_qposadr[joint]]) if mj.jnt_stiffness[joint] else 0.0,
            "damping": float(mj.dof_damping[dof]),
            "armature": float(mj.dof_armature[dof]),
            "frictionloss": float(mj.dof_frictionloss[dof]),
        }
        limited = f' range="{_numbers(mj.jnt_range[joint])}"' if mj.jnt_limited[joint] else ""
        return limited + "".join(f' {key}="{value:.6g}"' for key, value in values.items() if value)

    def equalities(self) -> Iterator[str]:
        """Yield the constraints on passive joints."""
        passive, name = self.robot.passive, self.robot.joint_name
        for each in passive.couplings:
            if each.follower in passive.simulated and each.leader in self.robot.driven | passive.simulated:
                ends = f'joint1="{escape(name(each.follower))}" joint2="{escape(name(each.leader))}"'
                yield f'<joint {ends} polycoef="{_numbers(each.polynomial)}" {each.softness}/>'
        for number, loop in enumerate(passive.loops, 1):
            yield f'<connect site1="joint_{number}_a" site2="joint_{number}_b" {loop.softness}/>'

    def shapes(self, body: int, here: FloatArray, rotation: FloatArray) -> Iterator[str]:
        """Yield sites and geoms of a body."""
        if body == self.robot.pelvis:
            yield '<site name="imu"/>'
        if side := self.feet.get(body):
            own_sole = self.geometry.soles[side]
            local = rotation.T @ (own_sole.origin - here)
            yield f'<site name="{side[0]}_sole"{_pose(local, rotation.T @ own_sole.rotation)}/>'
            yield from self.corners(own_sole, here, rotation)
        if side := self.hands.get(body):
            palm = _pose(rotation.T @ (self.geometry.palms[side] - here), rotation.T @ self.robot.forward)
            yield f'<site name="{side[0]}_gripper"{palm}/>'
        for number, loop in enumerate(self.robot.passive.loops, 1):
            for end, letter in enumerate("ab"):
                if loop.bodies[end] == body:
                    at = _pose(rotation.T @ (loop.points[end] - here), np.eye(3))
                    yield f'<site name="joint_{number}_{letter}"{at}/>'
        if pad := self.geometry.pads.get(body):
            yield from self.corners(pad, here, rotation)
        if shape := self.geometry.capsules.get(body):
            own = rotation.T @ self.source.rotation(body)
            kind = "finger" if body in self.fingers else "body"
            ends = _numbers([*own @ shape.start, *own @ shape.end])
            yield f'<geom class="{kind}" size="{shape.radius:.4g}" fromto="{ends}"/>'
        if self.visible:
            yield from self.visuals(body, here, rotation)

    def corners(self, sole: Sole, here: FloatArray, rotation: FloatArray) -> Iterator[str]:
        """Yield the spheres at a sole's corners."""
        for x in (sole.heel, sole.toe):
            for y in (-sole.half_width, sole.half_width):
                corner = sole.origin + sole.rotation @ np.array([x, y, self.geometry.ball]) - here
                yield f'<geom class="sole" pos="{_numbers(rotation.T @ corner)}"/>'

    def visuals(self, body: int, here: FloatArray, rotation: FloatArray) -> Iterator[str]:
        """Yield the visible geoms of a body: those that do not collide, or else those that do."""
        mj = self.mj
        mine = self.source.geoms([body])
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
        """Return the name of a visible mesh."""
        if mesh not in self.meshes:
            name = re.sub(r"\W+", "_", self.mj.mesh(mesh).name or "mesh")
            self.meshes[mesh] = f"{name}_{mesh}" if name in self.meshes.values() else name
        return self.meshes[mesh]


def _pose(position: FloatArray, rotation: FloatArray) -> str:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).flatten())
    place = "" if np.linalg.norm(position) < 1e-9 else f' pos="{_numbers(position)}"'
    return place + ("" if abs(quaternion[0]) > 1 - 1e-9 else f' quat="{_numbers(quaternion)}"')


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{0.0 if abs(value) < 5e-8 else value:.7g}" for value in values)


def _write_meshes(mj: mujoco.MjModel, names: Mapping[int, str], folder: Path, leg: float) -> None:
    """Write meshes (id → name) as STL to a folder, coarser until they have at most 120,000 faces."""
    drawn = {mesh: _triangles(mj, mesh) for mesh in names}
    coarse, cell = drawn, _CELL * leg
    while sum(len(faces) for _, faces in coarse.values()) > _MOST_FACES:
        coarse = {mesh: coarsen(*drawn[mesh], cell) for mesh in names}
        cell *= _COARSER
    for mesh, (vertices, faces) in coarse.items():
        folder.mkdir(exist_ok=True)
        (folder / f"{names[mesh]}.stl").write_bytes(stl(vertices, faces))


def coarsen(vertices: FloatArray, faces: Faces, cell: float) -> Triangles:
    """Merge the vertices (k, 3) in each cell of a grid of size ``cell`` [m] (Rossignac and Borrel, 1993).

    Returns a small mesh, or one that would collapse, unchanged. ``faces``: (m, 3) indices.
    """
    if len(faces) <= _FEW_FACES:
        return vertices, faces
    _, index = np.unique(np.floor(vertices / cell).astype(np.int64), axis=0, return_inverse=True)
    index = index.reshape(-1)
    count = np.bincount(index)
    mean = np.stack([np.bincount(index, vertices[:, axis]) / count for axis in range(3)], axis=1)
    merged = index[faces]
    merged = merged[(merged[:, 0] != merged[:, 1]) & (merged[:, 1] != merged[:, 2]) & (merged[:, 2] != merged[:, 0])]
    if not len(merged):
        return vertices, faces
    _, first = np.unique(np.sort(merged, axis=1), axis=0, return_index=True)
    merged = merged[np.sort(first)].astype(np.int32)
    return (mean, merged) if len(np.unique(merged)) >= 12 else (vertices, faces)


def _triangles(mj: mujoco.MjModel, mesh: int) -> Triangles:
    vertices = mj.mesh_vert[mj.mesh_vertadr[mesh] : mj.mesh_vertadr[mesh] + mj.mesh_vertnum[mesh]]
    faces = mj.mesh_face[mj.mesh_faceadr[mesh] : mj.mesh_faceadr[mesh] + mj.mesh_facenum[mesh]]
    return np.asarray(vertices, dtype=np.float64), np.asarray(faces)
