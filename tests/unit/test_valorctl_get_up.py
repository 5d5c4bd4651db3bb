"""What `get-up` reports while a robot gets up, and what it makes of one that does not."""

import threading
from collections.abc import Sequence

import pytest

from harness.instance import RunningInstance
from harness.motion_states import motion_state
from valor.common.behaviors import requested_by
from valor.common.errors import ValorError
from valor.common.messages import BehaviorReply, BehaviorRequest
from valor.common.topics import BEHAVIOR, MOTION_STATE
from valor.valorctl.drive.getting_up import GETTING_UP, get_up

Said = tuple[str, str]  # behavior, reason
POSES = ["getting up, 2 of 3: kneel", "getting up, 3 of 3: straighten"]
RISING: list[Said] = [("get_up", requested_by("valorctl")), *(("get_up", pose) for pose in POSES)]
SECOND = 10**9
LIMIT = 30.0  # until the name service reports a server [s]


class ScriptedMotionManager:
    """Lies until it is asked, and then reports one state after the other, each a second after the last was shown."""

    def __init__(self, instance: RunningInstance, states: Sequence[Said]) -> None:
        node = instance.node("motion_manager")
        self._states = MOTION_STATE.publisher(node)
        self._server = BEHAVIOR.server(node, self._answer)
        self._script: list[Said] = [("fall", "lost"), *states]
        self._at = 0
        self.shown: list[str] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _answer(self, request: BehaviorRequest, origin: str) -> BehaviorReply:
        assert (request.behavior, origin) == ("get_up", "valorctl")
        self._at += 1
        return BehaviorReply(accepted=True, behavior="fall", reason="", obstacle="")

    def _run(self) -> None:
        while not self._over.wait(0.02):
            self._server.serve()
            behavior, reason = self._script[self._at]
            self._states.publish(motion_state(time=self._at * SECOND, behavior=behavior, reason=reason))

    def show(self, text: str) -> None:
        if text not in self.shown:
            self.shown.append(text)
            self._at += 1

    def close(self) -> None:
        self._over.set()
        self._thread.join()


@pytest.mark.parametrize("failure", ["", "getting up was given up: kneel: the pelvis rolled 50°"])
def test_every_pose_is_reported_then_the_robot_is_up_or_why_not(instance: RunningInstance, failure: str) -> None:
    end = ("fall", failure) if failure else ("stand_prep", "up again")
    scripted = ScriptedMotionManager(instance, [*RISING, end])
    try:
        assert BEHAVIOR.client(instance.node("observer")).wait_for_server(LIMIT)
        if failure:
            with pytest.raises(ValorError, match=f"not up: fall: {failure}"):
                get_up(instance.instance, lambda: None, scripted.show)
        else:
            assert get_up(instance.instance, lambda: None, scripted.show) == len(RISING)
    finally:
        scripted.close()
    assert scripted.shown == [GETTING_UP, *POSES]
