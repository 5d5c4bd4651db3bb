"""What the robot is doing when something happens: each begins, goes on in a thread of its own, and is ended."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

import bifrost
from tests.soak.rig import BrokenError, Rig
from valor.common import membership
from valor.common.behaviors import Behavior
from valor.common.errors import ValorError
from valor.common.messages import MotionState, PushRequest, VelocityCommand
from valor.common.topics import PUSH, VALORCTL, VELOCITY
from valor.valorctl import arm_motion, stepping

SPEED = 0.3  # forward [m/s]
_PERIOD = 0.02  # between velocities [s]
_MOVING = 0.1  # of a pelvis that has begun to walk [m/s]


class EnoughError(ValorError):
    """The activity is told to end."""


class Going:
    """An activity under way.

    Attributes:
        trouble: why it ended before it was told to; empty: it did not.
    """

    def __init__(self, work: Callable[[Callable[[], None]], None]) -> None:
        self._enough = threading.Event()
        self.trouble = ""
        self._work = work
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._work(self._check)
        except EnoughError:
            pass
        except (ValorError, bifrost.Error, BrokenError) as error:
            self.trouble = str(error)

    def _check(self) -> None:
        if self._enough.is_set():
            raise EnoughError("enough")

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        return not self._thread.is_alive()

    def end(self) -> None:
        """Tell it to, and wait until it has."""
        self._enough.set()
        self._thread.join()


Begin = Callable[[Rig, random.Random], Going]


def _nothing(check: Callable[[], None]) -> None:
    while True:
        check()
        time.sleep(_PERIOD)


def _standing(rig: Rig, _: random.Random) -> Going:
    return Going(_nothing)


def _frozen(rig: Rig, _: random.Random) -> Going:
    """In Freeze with an arm up: what may not come down."""
    rig.go(Behavior.STAND_MANIPULATE)
    arm_motion.move_limb(rig.instance, "right", "arm", "forward", speed=0.5, tolerance=0.2)
    rig.go(Behavior.FREEZE)
    rig.rest()
    return Going(_nothing)


def _soft_stop(rig: Rig, _: random.Random) -> Going:
    rig.go(Behavior.SOFT_STOP)
    rig.rest()
    return Going(_nothing)


def _walking(rig: Rig, rng: random.Random) -> Going:
    rig.go(Behavior.WALK)
    turn = rng.uniform(-0.2, 0.2)

    def walk(check: Callable[[], None]) -> None:
        network = membership.network(rig.instance, VALORCTL)
        with bifrost.Node("valorctl", network=network) as node:
            velocity = VELOCITY.publisher(node)
            while True:
                check()
                state = rig.tap.state
                assert state is not None
                velocity.publish(VelocityCommand(state.time, SPEED, 0.0, turn))
                time.sleep(_PERIOD)

    going = Going(walk)

    def moves() -> bool:
        state: MotionState | None = rig.tap.state
        return state is not None and state.pelvis_linear_velocity_in_odom[0] ** 2 > _MOVING**2

    rig.wait(lambda: going.over or moves(), "the robot walking")
    return going


def _stepping(rig: Rig, rng: random.Random) -> Going:
    goal = (rng.choice((0.3, -0.2)), 0.0, 0.0)

    def step(check: Callable[[], None]) -> None:
        stepping.step_to(rig.instance, goal, relative=True, check=check)

    going = Going(step)
    rig.wait(lambda: going.over or rig.behavior is Behavior.STEP, "the robot stepping")
    return going


def _reaching(rig: Rig, rng: random.Random) -> Going:
    rig.go(Behavior.STAND_MANIPULATE)
    side = rng.choice(arm_motion.SIDES)

    def move(check: Callable[[], None]) -> None:
        for preset in ("forward", "down") * 10:
            check()
            arm_motion.move_limb(rig.instance, side, "arm", preset, speed=0.3, tolerance=0.2, check=check)

    rig.tap.mark()
    going = Going(move)
    rig.wait(lambda: going.over or rig.tap.moved()[1] > 0.1, "an arm moving")
    return going


def _fallen(rig: Rig, _: random.Random) -> Going:
    """Pushed over where it can be pushed, else let go."""
    network = membership.network(rig.instance, VALORCTL)
    with bifrost.Node("valorctl", network=network) as node:
        pusher = PUSH.client(node)
        if pusher.wait_for_server(2.0):
            pusher.call(PushRequest(np.array([120.0, 0.0, 0.0]), 0.1), timeout=5.0)
        else:
            rig.go(Behavior.FALL)
    rig.wait(lambda: rig.behavior is Behavior.FALL, "the fall told")
    began = rig.time
    rig.wait(lambda: rig.time > began + 3.0, "the robot on the floor")  # it gives way for a minute yet
    return Going(_nothing)


@dataclass(frozen=True)
class Activity:
    """One line of the table.

    Attributes:
        begin: brings the robot there from Stand.
        weight: how often it comes, relative to the others.
        held: the joints stay where they are, whoever dies; those of a limp robot do not.
    """

    begin: Begin
    weight: float
    held: bool


ACTIVITIES: Mapping[str, Activity] = {
    "standing": Activity(_standing, 6.0, True),
    "walking": Activity(_walking, 4.0, False),
    "stepping": Activity(_stepping, 3.0, False),
    "reaching": Activity(_reaching, 3.0, False),
    "soft stop": Activity(_soft_stop, 1.0, True),
    "frozen": Activity(_frozen, 2.0, True),
    "fallen": Activity(_fallen, 0.5, False),
}
