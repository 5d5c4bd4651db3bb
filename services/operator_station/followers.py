"""Cameras that go with the robot, each viewer's own."""

from __future__ import annotations

import numpy as np
from viser import ViserServer

from valor.operator_station.scene import Scene

FAR = 0.05  # that the robot goes until the cameras follow [m]


class Followers:
    """Moves every viewer's camera along with the pelvis; how they look at it stays theirs."""

    def __init__(self, server: ViserServer, scene: Scene) -> None:
        self._server, self._scene = server, scene
        self._at = scene.body.data.qpos[:2].copy()
        gui = server.gui
        self._follow = gui.add_checkbox("the camera follows the robot", True)
        self._ghost = gui.add_checkbox("ghost of the commanded joints", False)

    def draw(self) -> None:
        """Follow."""
        self._scene.show_commanded = bool(self._ghost.value)
        here = self._scene.body.data.qpos[:2]
        way = here - self._at
        if np.linalg.norm(way) < FAR:
            return
        self._at = here.copy()
        if not self._follow.value:
            return
        for client in self._server.get_clients().values():
            if client.camera.update_timestamp:  # it has said where it is
                client.camera.position = np.asarray(client.camera.position) + np.array((*way, 0.0))
