"""What the robot is doing when something happens: each begins, goes on in a thread of its own, and is ended."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

import bifrost
from tests.soak.rig import Rig
from valor.common import topics
from valor.common.behaviors import Behavior
from valor.common.errors import ValorError
from valor.common.messages import MotionState, PushRequest
from valor.common.topics import PUSH
from valor.valorctl.drive import arm_motion, stepping

SPEED = 0.3  # forward [m/s]
_PERIOD = 0.02  # between velocities [s]
_MOVING = 0.1  # of a pelvis that has begun to walk [m/s]


class EnoughError(ValorError):
    """The activity is commanded to end."""


class Going:
    """An activity under way, in a thread."""

    def __init__(self, work: Callable[[Callable[[], None]], None]) -> None:
        self._enough = threading.Event()
        self._done = ThreadPoolExecutor(1).submit(work, self._check)

    def _check(self) -> None:
        if self._enough.is_set():
            raise EnoughError("enough")

    @property
    def over(self) -> bool:
        return self._done.done()

    def end(self) -> str:
        """End it; returns why it ended by itself."""
        self._enough.set()
        error = self._done.exception()
        return "" if error is None or isinstance(error, EnoughError) else str(error)


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
    from geometry_msgs.msg import Twist

    from valor.valorctl.drive.ros_client import RosClient

    def walk(check: Callable[[], None]) -> None:
        twist = Twist()
        twist.linear.x, twist.angular.z = SPEED, turn
        with RosClient(rig.instance, check) as ros:
            velocity = ros.publisher(Twist, "cmd_vel", 1)
            while True:
                check()
                velocity.publish(twist)
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
    network = topics.network(rig.instance)
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
    begin: Begin  # from Stand
    weight: float  # relative frequency
    held: bool  # the joints stay where they are, whichever process is killed


ACTIVITIES: Mapping[str, Activity] = {
    "standing": Activity(_standing, 6.0, True),
    "walking": Activity(_walking, 4.0, False),
    "stepping": Activity(_stepping, 3.0, False),
    "reaching": Activity(_reaching, 3.0, False),
    "soft stop": Activity(_soft_stop, 1.0, True),
    "frozen": Activity(_frozen, 2.0, True),
    "fallen": Activity(_fallen, 0.5, False),
}
