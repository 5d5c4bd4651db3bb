"""Behaviors and control modes are spelled in one place, and every table that goes by them knows all of them."""

from __future__ import annotations

import ast
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.places import REPOSITORY
from valor.analysis import bands
from valor.common.behaviors import (
    FALLEN,
    INTERNAL_STATES,
    MANIPULATING,
    STEPPING,
    STOPPED,
    WALKING,
    Behavior,
    ControlMode,
    Locomotion,
    Reaction,
    requested_by,
    requester,
)
from valor.motion_manager.safety.device_reactions import DEMANDS, ENOUGH
from valor.motion_manager.states.transitions import BEHAVIOR_TRANSITIONS, RESUMED, WAY_BACK
from valor.valor_ros_controller.control_modes import ControlModeTable

MODES = ControlModeTable.load()
HOME = REPOSITORY / "valor" / "common" / "behaviors.py"
EVERYDAY_WORDS = {"none", "idle", "stop", "step"}  # and of a plan, a verb, a clock, an option


def product() -> list[Path]:
    """Every Python file of the product."""
    return [
        Path(folder) / name
        for root in ("bifrost", "services", "valor")
        for folder, _, names in os.walk(REPOSITORY / root)
        for name in names
        if name.endswith(".py")
    ]


def test_names_are_spelled_in_one_module() -> None:
    names = {*Behavior, *ControlMode} - EVERYDAY_WORDS
    spelled = [
        f"{file.relative_to(REPOSITORY)}:{node.lineno}: {node.value!r}"
        for file in product()
        if file != HOME
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in names
    ]
    assert not spelled


@pytest.mark.parametrize("behavior", Behavior)
def test_every_table_knows_every_behavior(behavior: Behavior) -> None:
    assert behavior in INTERNAL_STATES
    assert behavior in BEHAVIOR_TRANSITIONS
    assert behavior in MODES.behaviors
    assert behavior in RESUMED
    assert behavior in WAY_BACK
    assert behavior.locomotion in bands.COLORS


@pytest.mark.parametrize("behavior", Behavior)
@pytest.mark.parametrize("demand", DEMANDS)
def test_devices_that_fail_are_answered_in_every_behavior(demand: Reaction, behavior: Behavior) -> None:
    edges = BEHAVIOR_TRANSITIONS[behavior]
    assert behavior in ENOUGH[demand] or any(wanted is behavior or wanted in edges for wanted in DEMANDS[demand])


def test_control_modes_are_the_rows_of_their_table() -> None:
    assert list(MODES.modes) == list(ControlMode)


@pytest.mark.parametrize("behavior", Behavior)
def test_what_is_true_of_a_behavior_follows_from_its_internal_states(behavior: Behavior) -> None:
    assert behavior.operational <= behavior.balancing
    assert behavior.manipulating <= behavior.operational
    assert not (behavior.fallen and (behavior.balancing or behavior.stopped))
    assert (behavior in STEPPING | WALKING) is behavior.locomotion.stepping
    assert behavior.manipulating is behavior.endswith("_manipulate")


@pytest.mark.parametrize("locomotion", Locomotion)
def test_every_state_of_locomotion_is_that_of_a_behavior(locomotion: Locomotion) -> None:
    assert locomotion in {behavior.locomotion for behavior in Behavior}
    assert locomotion.stepping <= locomotion.recovering <= locomotion.balancing


def test_names_off_the_wire_are_looked_up_as_they_are() -> None:
    heard = np.array(["stand", "fall", "walk_manipulate", "dance", ""])
    assert np.isin(heard, [*MANIPULATING]).tolist() == [False, False, True, False, False]
    assert (heard == Behavior.FALL).tolist() == [False, True, False, False, False]
    assert [str(name) in FALLEN for name in heard] == [False, True, False, False, False]
    assert {"soft_stop", "freeze"} == STOPPED


@examples(100)
@given(st.text(min_size=1))
def test_who_asked_for_a_change_is_read_from_its_reason(origin: str) -> None:
    assert requester(requested_by(origin)) == origin


@examples(100)
@given(st.text().filter(lambda text: not text.startswith(requested_by(""))))
def test_a_change_that_came_by_itself_has_no_requester(reason: str) -> None:
    assert requester(reason) == ""
