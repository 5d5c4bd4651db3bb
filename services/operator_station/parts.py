"""What every part of the page works with."""

from __future__ import annotations

from dataclasses import dataclass

from viser import ViserServer

from valor.operator_station.commander import Commander
from valor.operator_station.desk import Desk
from valor.operator_station.heard import Heard
from valor.operator_station.scene import Scene


@dataclass(frozen=True)
class Parts:
    """Of one station.

    Attributes:
        server: of the page.
        desk: where commands are taken.
        commander: what sends them.
        heard: what the robot says.
        scene: what is seen.
    """

    server: ViserServer
    desk: Desk
    commander: Commander
    heard: Heard
    scene: Scene
