"""What a viewer has alone: becoming the operator, and giving that back."""

from __future__ import annotations

from collections.abc import Callable

from viser import ClientHandle

from valor.operator_station.desk import Desk, Visit


class Joining:
    """A folder in each viewer's own panel."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk

    def arrived(self, client: ClientHandle) -> None:
        """Somebody looks on."""
        gui, desk = client.gui, self._desk
        with gui.add_folder("Operator", order=-10.0, expand_by_default=True):
            name = gui.add_text("name", f"viewer {client.client_id}")
            token = gui.add_text("token", "", hint="in the file operator.token of the instance's folder")
            buttons: tuple[tuple[str, Callable[[Visit], None]], ...] = (
                ("Take control", lambda visit: desk.claim(visit, name.value, token.value, over=False)),
                ("Take over", lambda visit: desk.claim(visit, name.value, token.value, over=True)),
                ("Give back", self._give_back),
            )
            for label, act in buttons:
                gui.add_button(label).on_click(desk.taking(act))

    def _give_back(self, visit: Visit) -> None:
        if self._desk.lease.release(visit.viewer):
            for each in self._desk.gone:
                each()
            self._desk.notify(visit.viewer, "you look on")
