"""3-D scene of the page: world, robot, previews and overlays."""

from __future__ import annotations

import logging
from collections.abc import Mapping

import mujoco
import numpy as np
from viser import FrameHandle, SceneApi, ViserServer

from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.operator_station.robot.snapshot import RobotSnapshot
from valor.operator_station.scene import shapes
from valor.operator_station.scene.body import Body
from valor.operator_station.scene.overlays import Footprints, Overlays
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.simulation import worlds

_STILL = (2e-4, 2e-4)  # largest change that is not sent [m, 1]

Color = tuple[int, int, int]


class Figure:
    """Robot as a tree of frames with one mesh per color; sends only frames that move."""

    def __init__(
        self, scene: SceneApi, name: str, body: Body, *, color: Color | None = None, opacity: float | None = None
    ) -> None:
        """Add it to the scene; ``color`` (None: the robot's) and ``opacity`` are for previews."""
        model = body.model.mj
        self.root = scene.add_frame(f"/{name}", show_axes=False)
        self._parents = np.array(model.body_parentid)
        paths = {0: f"/{name}"}
        self._frames: list[FrameHandle] = []
        for number in range(1, model.nbody):
            paths[number] = f"{paths[int(self._parents[number])]}/{model.body(number).name}"
            self._frames.append(scene.add_frame(paths[number], show_axes=False))
            for place, mesh in enumerate(shapes.of_body(model, number)):
                _add(scene, f"{paths[number]}/mesh{place}", mesh, color, opacity)
        self._positions = np.full((model.nbody - 1, 3), np.nan)
        self._orientations = np.full((model.nbody - 1, 4), np.nan)

    def draw(self, body: Body) -> None:
        """Move the frames to a posture."""
        position, orientation = local_poses(body, self._parents)
        moved = (np.abs(position - self._positions).max(axis=1) <= _STILL[0]) & (
            np.abs(orientation - self._orientations).max(axis=1) <= _STILL[1]
        )
        changed = np.flatnonzero(~moved)
        for place in changed.tolist():
            frame = self._frames[place]
            if not np.abs(position[place] - self._positions[place]).max() <= _STILL[0]:
                frame.position = position[place]
            if not np.abs(orientation[place] - self._orientations[place]).max() <= _STILL[1]:
                frame.wxyz = orientation[place]
        self._positions[changed] = position[changed]
        self._orientations[changed] = orientation[changed]


def local_poses(body: Body, parents: np.ndarray[tuple[int], np.dtype[np.int32]]) -> tuple[FloatArray, FloatArray]:
    """Return (b, 3) positions [m] and (b, 4) orientations of all bodies but the world in their parents."""
    data = body.data
    mother = parents[1:]
    w, x, y, z = data.xquat[mother].T * np.array([[1.0], [-1.0], [-1.0], [-1.0]])
    a, b, c, d = data.xquat[1:].T
    orientation = np.column_stack((
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    ))  # fmt: skip
    turns = data.xmat[mother].reshape(-1, 3, 3)
    position = np.einsum("bji,bj->bi", turns, data.xpos[1:] - data.xpos[mother])
    return position, orientation


LEAST = 1e-3  # smallest rotation that is drawn [rad]


class Surroundings:
    """Shapes of the simulated world; ``frames`` are of its moving bodies.

    odom and world agree at the robot's start, and drift apart with odometry.
    """

    def __init__(self, scene: SceneApi, model: mujoco.MjModel) -> None:
        """Draw it with all joints at 0."""
        self._model, self._data = model, mujoco.MjData(model)
        mujoco.mj_kinematics(model, self._data)
        self._drawn = np.zeros(model.nq)
        for place, mesh in enumerate(shapes.of_world(model)):
            _add(scene, f"/world/{place}", mesh)
        self.frames = {}
        for body in moving(model):
            name = f"/world/body_{body}"
            self.frames[body] = scene.add_frame(name, show_axes=False)
            for place, mesh in enumerate(shapes.of_body(model, body)):
                _add(scene, f"{name}/{place}", mesh)
        self._place()

    def turn(self, positions: FloatArray) -> None:
        """Move its joints [rad]; ignores positions of another world."""
        if positions.size == self._drawn.size and np.abs(positions - self._drawn).max(initial=0.0) >= LEAST:
            self._drawn = positions.copy()
            self._data.qpos[:] = positions
            mujoco.mj_kinematics(self._model, self._data)
            self._place()

    def _place(self) -> None:
        for body, frame in self.frames.items():
            frame.position, frame.wxyz = self._data.xpos[body].copy(), self._data.xquat[body].copy()


def moving(model: mujoco.MjModel) -> list[int]:
    """Return the bodies that are not fixed to the world."""
    return [int(body) for body in np.flatnonzero(model.body_weldid)]


def _add(
    scene: SceneApi, name: str, mesh: shapes.Mesh, color: Color | None = None, opacity: float | None = None
) -> None:
    scene.add_mesh_simple(
        name, mesh.vertices.astype(np.float32), mesh.faces, color=color or mesh.color, opacity=opacity,
        flat_shading=True, cast_shadow=False, receive_shadow=False,
    )  # fmt: skip


WANTED = (255, 150, 20)
REFUSED = (220, 40, 40)
SLOW = 3  # frames per update of overlays

World = tuple[str, int]  # name and seed
_log = logging.getLogger("operator_station")


class Scene:
    """Draws received values; ``body`` has the measured posture, ``wanted`` that of the preview."""

    def __init__(self, server: ViserServer, model: Model, world: World | None) -> None:
        scene = server.scene
        self.body, self.wanted = Body(model), Body(model)
        scene.set_up_direction("+z")
        scene.configure_default_lights(enabled=True, cast_shadow=False)
        scene.add_grid("/floor", 40.0, 40.0, cell_size=0.5, section_size=1.0, plane_opacity=0.0, shadow_opacity=0.0)
        self._surroundings = None if world is None else _surroundings(scene, world, model.robot)
        self._robot = Figure(scene, "robot", self.body)
        self._ghosts = {
            False: Figure(scene, "wanted", self.body, color=WANTED, opacity=0.45),
            True: Figure(scene, "refused", self.body, color=REFUSED, opacity=0.45),
        }
        self.preview({}, False)
        self._overlays = Overlays(scene, self.body)
        self._plan = Footprints(scene, "plan", self.body, 0.8)
        self.preview_steps = Footprints(scene, "preview", self.body, 0.35)
        self._frame = 0
        # From its left, so that the panel does not cover the floor ahead.
        server.initial_camera.position = np.array((2.0, 2.2, 1.6))
        server.initial_camera.look_at = np.array((0.0, 0.0, 0.7))

    def draw(self, heard: RobotSnapshot, now: float) -> None:
        """Draw a frame; ``now`` is monotonic [s]."""
        body = self.body
        if heard.joints:
            joints = body.joints.copy()
            for name, angle in heard.joints.items():
                if (place := body.model.robot.index.get(name)) is not None:
                    joints[place] = angle
            body.pose(joints)
            body.place(heard.pelvis.position, heard.pelvis.orientation)
            body.update()
            self._robot.draw(body)
        self._robot.root.visible = bool(heard.joints)
        if self._surroundings is not None:
            self._surroundings.turn(heard.fixtures)
        self._frame += 1
        if self._frame % SLOW == 0:
            self._overlays.draw(heard, body, now)
            self._plan.show(heard.steps)

    def preview(self, joints: Mapping[str, float], refused: bool) -> None:
        """Show joint positions [rad], or hide the preview without any."""
        self.wanted.like(self.body)
        self.wanted.bend(joints)
        self.wanted.update()
        for bad, ghost in self._ghosts.items():
            ghost.root.visible = bool(joints) and bad is refused
            if ghost.root.visible:
                ghost.draw(self.wanted)


def _surroundings(scene: SceneApi, world: World, robot: RobotDescription) -> Surroundings | None:
    """The simulated world, or None if it is not available."""
    try:
        return Surroundings(scene, worlds.load(*world, worlds.size_of(robot)).compile())
    except (ValorError, ValueError) as error:
        _log.warning("the world is not drawn: %s", error)
        return None
