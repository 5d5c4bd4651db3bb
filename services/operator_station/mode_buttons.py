"""A button for each control mode, which says why it may not be pressed now."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from viser import GuiApi

from valor.operator_station.modes import Mode, Modes


class ModeButtons:
    """They are grey until ``show`` has said otherwise.

    Attributes:
        buttons: by mode.
    """

    def __init__(self, gui: GuiApi, modes: Modes, pressed: Callable[[str], Any]) -> None:
        """``pressed``: gives what a mode's button does."""
        self._modes = modes
        self.buttons = {name: gui.add_button(name, disabled=True) for name in modes.names}
        for name, button in self.buttons.items():
            button.on_click(pressed(name))

    def show(self, mode: Mode, behavior: str) -> None:
        """Of a robot in a mode and a behavior: which may be pressed, and why others may not."""
        for name, button in self.buttons.items():
            why = self._modes.why_not(name, mode, behavior)
            label = f"{name}  ✓" if name == mode.current else f"{name} – {why}" if why else name
            if (button.label, button.disabled) != (label, bool(why)):
                button.label, button.disabled = label, bool(why)
