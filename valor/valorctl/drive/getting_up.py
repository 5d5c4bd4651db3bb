"""`get-up`."""

import time
from collections.abc import Callable, Container

import bifrost
from valor.common.behaviors import Behavior, Obstacle, requester
from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.messages import BehaviorRequest
from valor.common.topics import BEHAVIOR, MOTION_STATE
from valor.valorctl.drive.node import join, next_message

GETTING_UP = "getting up"  # shown until the robot reports the pose that it moves to
LONGEST = 120.0  # of wall time [s]
_TIMEOUT = 2.0  # of replies and states [s]
BY_ITSELF = "a robot that can get up also: `valorctl get-up`"
BY_HAND = "hang a real one upright, then `valorctl stop --freeze`, `valorctl mode stand_prep`"
OTHERWISE = f"`valorctl reset` puts a simulated robot on its feet; {BY_HAND}"


def simulated(settings: Settings, processes: Container[str]) -> bool:
    """Whether ``reset`` can place the robot of an instance with some processes."""
    return settings.variant == "simulation" or "device_emulators" in processes


def get_up(instance: Instance, check: Callable[[], None], shown: Callable[[str], None]) -> float:
    """Request Get Up and wait for its end; returns the duration [robot time, s].

    ``check`` may raise: the robot continues; ``shown`` receives its current action. Raises ``ValorError``: not up.
    """
    with join(instance) as node:
        states = MOTION_STATE.subscriber(node)
        try:
            reply = BEHAVIOR.client(node).call(BehaviorRequest(Behavior.GET_UP), timeout=_TIMEOUT)
        except bifrost.Error as error:
            raise ValorError(f"the Motion Manager does not respond: {error}") from None
        if not reply.accepted:
            advice = f"; {OTHERWISE}" if reply.obstacle == Obstacle.CONDITION else ""
            raise ValorError(f"get_up rejected: {reply.reason}{advice}")
        began: int | None = None
        deadline = time.monotonic() + LONGEST
        while time.monotonic() < deadline:
            check()
            state = next_message(MOTION_STATE, states, _TIMEOUT)
            if state.behavior == Behavior.GET_UP:
                began = state.time if began is None else began
                shown(GETTING_UP if requester(state.reason) else state.reason)
            elif began is not None:
                if state.behavior != Behavior.STAND_PREP:
                    raise ValorError(f"not up: {state.behavior}: {state.reason}")
                return 1e-9 * (state.time - began)
    raise ValorError(f"still getting up after {LONGEST:g} s; see `valorctl status`")
