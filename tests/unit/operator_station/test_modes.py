"""Which modes the page offers: those that the VRC would not refuse, by its own rule."""

from itertools import product

from valor.common.errors import ValorError
from valor.common.messages import ModeStatus
from valor.operator_station.robot.modes import Mode, Modes, report
from valor.valor_ros_controller.control_modes import ControlModeTable, ModeRejectedError, admit

TABLE = ControlModeTable.load()


def refused(name: str, current: str, behavior: str) -> bool:
    try:
        admit(TABLE, name, current, behavior, "")
    except (ModeRejectedError, ValorError):
        return True
    return False


def test_a_mode_is_offered_exactly_where_the_vrc_would_follow() -> None:
    modes = Modes()
    assert modes.names == list(TABLE.modes)
    for current, name, behavior in product(TABLE.modes, TABLE.modes, TABLE.behaviors):
        if name != current:  # that is allowed, and does nothing
            offered = not modes.why_not(name, Mode(current), behavior)
            assert offered != refused(name, current, behavior), (name, current, behavior)


def test_why_not_names_the_first_mode_on_the_way() -> None:
    assert Modes().why_not("walk", Mode("soft_stop")) == "not from soft_stop: first stand"
    assert Modes().why_not("stand", Mode("")) == "the robot's control mode is not known"
    assert Modes().why_not("stand", Mode("stand")) == "the robot is in it"
    assert "no arm" in Modes(arms=False).why_not("stand_manipulate", Mode("stand"))
    changing = Mode("stand", "walk", int(ModeStatus.MODE_PROCESSING))
    assert Modes().why_not("step", changing) == "the change to walk is under way"
    assert not Modes().why_not("soft_stop", changing), "a stop is always possible"


def test_refusals_and_external_changes_are_reported() -> None:
    flags = ModeStatus.MODE_REJECTED | ModeStatus.ERR_INVALID_TRANSITION
    assert report(Mode("stand", "freeze", int(flags))) == "freeze was refused (ERR_INVALID_TRANSITION)"
    assert report(Mode("none", "walk", int(ModeStatus.EXTERNAL_CHANGE))) == "changed to none without being asked"
    assert report(Mode("walk", "walk", int(ModeStatus.MODE_ACCEPTED))) == ""
