"""Which process the VRC names when the Motion System falls silent, in lockstep, where one's end silences the other."""

from __future__ import annotations

import pytest

from harness.vrc_in_process import SILENCE, System
from valor.common import topics
from valor.common.messages import ClockStatus


@pytest.fixture
def system() -> System:
    """Everything speaks."""
    made = System()
    made.run(10)
    return made


def silence(system: System) -> str:
    """Whom the VRC names after nothing has come for too long."""
    system.clock += 2.0 * SILENCE
    system.vrc.interface.receive(0.0)
    system.vrc.interface.listen()
    return system.vrc.interface.silent


def test_nobody_is_named_while_both_speak(system: System) -> None:
    assert system.vrc.interface.silent == ""


def test_who_owes_a_motor_is_named(system: System) -> None:
    system.frozen = True
    system.run(2)
    assert silence(system) == "motion_manager"


def test_a_comms_manager_that_got_its_motor_is_named(system: System) -> None:
    assert silence(system) == "comms_manager"


def test_a_comms_manager_that_died_before_its_last_word_had_reached_everybody_is_named(system: System) -> None:
    """The Motion Manager seemed to owe a Motor to a Proprioceptor that the VRC alone had got."""
    system.frozen = True
    system.run(2)
    assert silence(system) == "motion_manager"  # as long as it is not known to be gone
    system.network.topic(topics.PROPRIOCEPTOR.name).publishers = ()
    assert silence(system) == "comms_manager"


def test_while_time_is_paused_nobody_is_named_and_afterwards_whoever_is(system: System) -> None:
    clock = system.network.topic(topics.CLOCK.name)

    def said(mode: str) -> None:
        clock.publish(ClockStatus(mode, 0, 0.0, 0.0, 0, False))

    for _ in range(5):
        said(topics.PAUSED)
        assert silence(system) == ""
    said("lockstep")
    assert silence(system) == "comms_manager"
    said(topics.PAUSED)
    assert silence(system) == "comms_manager", "who was silent before is no pause's"
