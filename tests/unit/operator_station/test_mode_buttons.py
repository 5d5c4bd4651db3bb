"""Which buttons of control modes may be pressed, whatever was known of the robot when the page was made."""

from collections.abc import Iterator

import pytest
from viser import ViserServer

from valor.operator_station.mode_buttons import ModeButtons
from valor.operator_station.modes import Mode, Modes


@pytest.fixture
def buttons() -> Iterator[ModeButtons]:
    server = ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield ModeButtons(server.gui, Modes(), lambda name: lambda event: None)
    server.stop()


def pressable(buttons: ModeButtons) -> list[str]:
    return [name for name, button in buttons.buttons.items() if not button.disabled]


@pytest.mark.parametrize("known_before", [False, True])
def test_what_is_allowed_may_be_pressed(buttons: ModeButtons, known_before: bool) -> None:
    assert pressable(buttons) == []
    if not known_before:
        buttons.show(Mode(), "")
        assert pressable(buttons) == []
    buttons.show(Mode("stand"), "stand")
    modes = Modes()
    assert pressable(buttons) == [name for name in modes.names if not modes.why_not(name, Mode("stand"), "stand")]
    assert "stand_manipulate" in pressable(buttons) and "stand" not in pressable(buttons)
