"""Panels of all viewers, and tabs of the operator."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import isfinite
from typing import Any

from viser import ClientHandle, GuiApi, GuiFolderHandle

from valor.common.errors import RefusalError
from valor.operator_station.commands.commander import Commander
from valor.operator_station.commands.queue import CommandQueue, UserEvent
from valor.operator_station.robot.snapshot import RobotSnapshot
from valor.operator_station.scene.scene import Scene


@dataclass(frozen=True)
class StationContext:
    """Objects of the station that the tabs use; ``client`` is the operator's."""

    client: ClientHandle
    desk: CommandQueue
    commander: Commander
    heard: RobotSnapshot
    scene: Scene


def bounded(value: Any, low: float, high: float) -> float:
    """Return a number of a browser within limits; raises ``RefusalError`` if it is none."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not isfinite(number):
        raise RefusalError("value", f"{value!r}: expected a number from {low:g} to {high:g}")
    return min(max(number, low), high)


def vector(values: Iterable[Any], size: int, most: float) -> tuple[float, ...]:
    """Return so many numbers of a browser, at most ``most`` each; raises ``RefusalError``."""
    numbers = tuple(bounded(value, -most, most) for value in values)
    if len(numbers) != size:
        raise RefusalError("value", f"{len(numbers)} numbers; expected {size}")
    return numbers


class Approval:
    """Button that approves what is previewed: a new one for each preview, so that a late press approves nothing."""

    def __init__(self, gui: GuiApi, folder: GuiFolderHandle, label: str, desk: CommandQueue) -> None:
        """Add it; called within the folder."""
        self._gui, self._folder, self._desk = gui, folder, desk
        self._button = gui.add_button(label, disabled=True, color="green")

    def offer(self, act: Callable[[UserEvent], None] | None, *, refused: bool = False) -> None:
        """Offer an action unless it is refused; None: nothing."""
        old = self._button
        with self._folder:
            self._button = self._gui.add_button(
                str(old.label), disabled=refused or act is None, color="green", order=old.order
            )
        old.remove()
        if act is not None:
            self._button.on_click(self._desk.taking(act))
