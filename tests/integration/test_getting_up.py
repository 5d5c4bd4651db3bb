"""What `get-up` tells while a robot gets up, and what it makes of one that does not."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import pytest

from harness.instance import RunningInstance
from harness.motion_states import motion_state
from valor.common.behaviors import requested_by
from valor.common.errors import ValorError
from valor.common.messages import BehaviorReply, BehaviorRequest
from valor.common.topics import BEHAVIOR, MOTION_STATE
from valor.valorctl.getting_up import GETTING_UP, get_up

Said = tuple[str, str]  # behavior, reason
POSES = ["getting up, 2 of 3: kneel", "getting up, 3 of 3: straighten"]
RISING: list[Said] = [("get_up", requested_by("valorctl")), *(("get_up", pose) for pose in POSES)]
SECOND = 10**9
LIMIT = 30.0  # until the name service tells of a server [s]


class ScriptedMotionManager:
    """Lies until it is asked, and then says one thing after the other: the next, a second later, once one was shown."""

    def __init__(self, instance: RunningInstance, says: Sequence[Said], refusal: str = "") -> None:
        node = instance.node("motion_manager")
        self._states = MOTION_STATE.publisher(node)
        self._server = BEHAVIOR.server(node, self._answer)
        self._says: list[Said] = [("fall", "lost"), *says]
        self._refusal = refusal
        self._at = 0
        self.shown: list[str] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _answer(self, request: BehaviorRequest, origin: str) -> BehaviorReply:
        assert (request.behavior, origin) == ("get_up", "valorctl")
        self._at += not self._refusal
        return BehaviorReply(accepted=not self._refusal, behavior="fall", reason=self._refusal, obstacle="")

    def _run(self) -> None:
        while not self._over.wait(0.02):
            self._server.serve()
            behavior, reason = self._says[self._at]
            self._states.publish(motion_state(time=self._at * SECOND, behavior=behavior, reason=reason))

    def show(self, text: str) -> None:
        """What `get-up` shows."""
        if text not in self.shown:
            self.shown.append(text)
            self._at += 1

    def close(self) -> None:
        self._over.set()
        self._thread.join()


@contextmanager
def motion_manager(
    instance: RunningInstance, says: Sequence[Said], refusal: str = ""
) -> Iterator[ScriptedMotionManager]:
    scripted = ScriptedMotionManager(instance, says, refusal)
    try:
        client = BEHAVIOR.client(instance.node("observer"))
        assert client.wait_for_server(LIMIT)
        yield scripted
    finally:
        scripted.close()


def test_every_pose_is_told_and_the_robot_is_up(instance: RunningInstance) -> None:
    with motion_manager(instance, [*RISING, ("stand_prep", "up again")]) as scripted:
        duration = get_up(instance.instance, lambda: None, scripted.show)
    assert scripted.shown == [GETTING_UP, *POSES]
    assert duration == len(RISING)


def test_who_gives_up_says_why(instance: RunningInstance) -> None:
    reason = "getting up was given up: kneel: the pelvis rolled 50°"
    with (
        motion_manager(instance, [*RISING, ("fall", reason)]) as scripted,
        pytest.raises(ValorError, match=f"not up: fall: {reason}"),
    ):
        get_up(instance.instance, lambda: None, scripted.show)


def test_a_refusal_is_told_in_its_words(instance: RunningInstance) -> None:
    with (
        motion_manager(instance, [], "the robot gets up from face-down only") as scripted,
        pytest.raises(ValorError, match="get_up refused: the robot gets up from face-down only"),
    ):
        get_up(instance.instance, lambda: None, scripted.show)
