"""The world in lockstep and the cycles that it waits for, over a real network."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from bifrost import Publisher
from harness.bifrost_network import BifrostNetwork, until
from valor.common.messages import ControllerCycle
from valor.common.topics import CYCLE
from valor.comms_manager.simulation import clock
from valor.comms_manager.simulation.clock import SLACK, VrcLockstep

FIRST, EVERY = 1000, 2


class World:
    """A world, and beside it one who does cycles in another node."""

    def __init__(self, net: BifrostNetwork) -> None:
        self.controller = net.node("controller")
        self.cycles: Publisher[ControllerCycle] = CYCLE.publisher(self.controller)
        subscriber = CYCLE.subscriber(net.node("world"))
        self.vrc_lockstep = VrcLockstep(subscriber)
        until(lambda: subscriber.drain() is not None and subscriber.publishers, "the controller")

    def done(self, sequence: int) -> None:
        self.cycles.publish(ControllerCycle(0, sequence, EVERY))

    def follow(self) -> None:
        """Have it be waited for."""
        assert self.vrc_lockstep.wait(FIRST) == 0.0, "nobody is waited for before a first cycle"

        def waited_for() -> bool:
            self.done(FIRST)
            self.vrc_lockstep.wait(FIRST)
            return self.vrc_lockstep._followed

        until(waited_for, "the first cycle taken in")


@pytest.fixture
def world(net: BifrostNetwork) -> World:
    return World(net)


def beside(function: Callable[[], object]) -> threading.Thread:
    thread = threading.Thread(target=function)
    thread.start()
    return thread


def test_the_world_waits_for_the_cycle_that_is_due_and_no_earlier(world: World) -> None:
    world.follow()
    for sequence in range(FIRST, FIRST + EVERY + SLACK):
        assert world.vrc_lockstep.wait(sequence) == 0.0, "none is overdue"
    due = FIRST + EVERY + SLACK
    sent = []

    def do_cycle() -> None:
        time.sleep(0.05)
        sent.append(time.perf_counter())
        world.done(due)

    thread = beside(do_cycle)
    assert world.vrc_lockstep.wait(due) > 0.0
    assert sent and time.perf_counter() >= sent[0], "the world went on before the cycle was done"
    thread.join()
    assert world.vrc_lockstep.waits_timed_out == 0 and not world.vrc_lockstep.note


def test_who_stalls_holds_the_world_up_once_is_named_and_is_waited_for_again(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clock, "CYCLE_TIMEOUT", 0.1)
    world.follow()
    late = FIRST + 100
    assert world.vrc_lockstep.wait(late) >= 0.1
    assert world.vrc_lockstep.waits_timed_out == 1
    assert "controller is not waited for: no cycle within 0.1 s" in world.vrc_lockstep.note
    for sequence in range(late + 1, late + 500):
        assert world.vrc_lockstep.wait(sequence) == 0.0, "it holds the world up no more"
    newest = late + 500

    def back() -> bool:
        world.done(newest)
        world.vrc_lockstep.wait(newest)
        return not world.vrc_lockstep.note

    until(back, "it is in step again")


def test_who_is_gone_is_not_waited_for(world: World) -> None:
    world.follow()
    thread = beside(world.controller.close)
    began = time.perf_counter()
    world.vrc_lockstep.wait(FIRST + 100)
    thread.join()
    assert time.perf_counter() - began < clock.CYCLE_TIMEOUT and world.vrc_lockstep.waits_timed_out == 0
    assert "it has disconnected" in world.vrc_lockstep.note


@pytest.mark.parametrize(("sequence", "every"), [(FIRST - 1, 2), (FIRST + 1, 2), (FIRST, 0), (FIRST, 10**9)])
def test_cycles_of_another_world_and_nonsense_bind_nobody(world: World, sequence: int, every: int) -> None:
    world.vrc_lockstep.wait(FIRST)
    for _ in range(20):
        world.cycles.publish(ControllerCycle(0, sequence, every))
        world.vrc_lockstep.wait(FIRST)
    assert not world.vrc_lockstep._followed
