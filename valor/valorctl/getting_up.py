"""Having the robot get up from the floor."""

from __future__ import annotations

import time
from collections.abc import Callable

import bifrost
from valor.common.behaviors import Behavior, requester
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import BehaviorRequest
from valor.common.topics import BEHAVIOR, MOTION_STATE
from valor.valorctl.node import hear, join

GETTING_UP = "getting up"  # shown until the robot says which pose it makes
LONGEST = 120.0  # of wall time [s]
_SILENT = 2.0  # [s]


def get_up(instance: Instance, check: Callable[[], None], shown: Callable[[str], None]) -> float:
    """Ask for Get Up and wait for what becomes of it.

    Args:
        instance: must be up.
        check: called while waiting; may raise to stop waiting. The robot goes on.
        shown: is told what the robot does.

    Returns:
        How long it took [robot time, s].

    Raises:
        ValorError: refused, given up, or the Motion Manager is silent.
    """
    with join(instance) as node:
        states = MOTION_STATE.subscriber(node)
        try:
            reply = BEHAVIOR.client(node).call(BehaviorRequest(Behavior.GET_UP), timeout=_SILENT)
        except bifrost.Error as error:
            raise ValorError(f"the Motion Manager does not answer: {error}") from None
        if not reply.accepted:
            raise ValorError(f"get_up refused: {reply.reason}")
        began: int | None = None
        deadline = time.monotonic() + LONGEST
        while time.monotonic() < deadline:
            check()
            state = hear(MOTION_STATE, states, _SILENT)
            if state.behavior == Behavior.GET_UP:
                began = state.time if began is None else began
                shown(GETTING_UP if requester(state.reason) else state.reason)
            elif began is not None:
                if state.behavior != Behavior.STAND_PREP:
                    raise ValorError(f"not up: {state.behavior}: {state.reason}")
                return 1e-9 * (state.time - began)
    raise ValorError(f"still getting up after {LONGEST:g} s")
