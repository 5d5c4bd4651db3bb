"""The scene of the page: the world, the robot, its ghosts, and what is drawn around it."""

from __future__ import annotations

import logging
from collections.abc import Mapping

import numpy as np
from viser import SceneApi, ViserServer

from valor.common.errors import ValorError
from valor.operator_station.body import Body
from valor.operator_station.figure import Figure
from valor.operator_station.heard import Heard
from valor.operator_station.overlays import Footprints, Overlays
from valor.operator_station.surroundings import Surroundings
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.simulation import worlds

COMMANDED = (40, 120, 220)
WANTED = (255, 150, 20)
REFUSED = (220, 40, 40)
SLOW = 3  # overlays are drawn in every so many frames

World = tuple[str, int]  # its name, and the seed of all that is random in it
_log = logging.getLogger("operator_station")


class Scene:
    """Draws what was heard.

    Attributes:
        body: the robot's posture, as it is.
        wanted: the posture of the preview.
        show_commanded: whether the ghost of the commanded joints is drawn.
    """

    def __init__(self, server: ViserServer, model: Model, world: World | None) -> None:
        scene = server.scene
        self.body, self._commanded, self.wanted = Body(model), Body(model), Body(model)
        scene.set_up_direction("+z")
        scene.configure_default_lights(enabled=True, cast_shadow=False)
        scene.add_grid("/floor", 40.0, 40.0, cell_size=0.5, section_size=1.0, plane_opacity=0.0, shadow_opacity=0.0)
        self._surroundings = None if world is None else _surroundings(scene, world, model.robot)
        self._robot = Figure(scene, "robot", self.body)
        self._ghosts = {
            "commanded": Figure(scene, "commanded", self.body, color=COMMANDED, opacity=0.35),
            "wanted": Figure(scene, "wanted", self.body, color=WANTED, opacity=0.45),
            "refused": Figure(scene, "refused", self.body, color=REFUSED, opacity=0.45),
        }
        for ghost in self._ghosts.values():
            ghost.show(False)
        self._overlays = Overlays(scene, self.body)
        self._plan = Footprints(scene, "plan", self.body, 0.8)
        self.preview_steps = Footprints(scene, "preview", self.body, 0.35)
        self.show_commanded = False
        self._frame = 0
        # From its left: ahead is where the panel does not cover the floor.
        server.initial_camera.position = np.array((2.0, 2.2, 1.6))
        server.initial_camera.look_at = np.array((0.0, 0.0, 0.7))

    def draw(self, heard: Heard, now: float) -> None:
        """One frame; ``now``: monotonic [s]."""
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
        self._robot.show(bool(heard.joints))
        if self._surroundings is not None:
            self._surroundings.turn(heard.fixtures)
        self._frame += 1
        if self._frame % SLOW == 0:
            self._overlays.draw(heard, body, now)
            self._plan.show(heard.steps)
            self._draw_commanded(heard)

    def _draw_commanded(self, heard: Heard) -> None:
        ghost = self._ghosts["commanded"]
        ghost.show(self.show_commanded)
        if self.show_commanded and len(heard.commanded) == len(self.body.joints):
            self._commanded.place(heard.pelvis.position, heard.pelvis.orientation)
            self._commanded.pose(heard.commanded)
            self._commanded.update()
            ghost.draw(self._commanded)

    def preview(self, joints: Mapping[str, float], refused: bool) -> None:
        """Show where some joints would be [rad]; none: nothing."""
        self._ghosts["wanted"].show(bool(joints) and not refused)
        self._ghosts["refused"].show(bool(joints) and refused)
        if joints:
            self.wanted.like(self.body)
            self.wanted.bend(joints)
            self.wanted.update()
            self._ghosts["refused" if refused else "wanted"].draw(self.wanted)


def _surroundings(scene: SceneApi, world: World, robot: RobotDescription) -> Surroundings | None:
    """The simulated world; None: it cannot be made."""
    try:
        return Surroundings(scene, worlds.load(*world, worlds.size_of(robot)).compile())
    except (ValorError, ValueError) as error:
        _log.warning("the world is not drawn: %s", error)
        return None
