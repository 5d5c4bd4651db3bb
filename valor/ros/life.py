"""Where a node is in its life, as of a managed node: https://design.ros2.org/articles/node_lifecycle.html.

The process configures itself when it starts, is active while it can do its work, and finalized when it ends. From
outside it can be paused (``deactivate``, ``activate``) where that means something; the other transitions are those of
whoever started the process.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.msg import Transition
from rclpy.lifecycle import LifecycleNode

_LABELS = {
    Transition.TRANSITION_CONFIGURE: "configure",
    Transition.TRANSITION_CLEANUP: "cleanup",
    Transition.TRANSITION_ACTIVATE: "activate",
    Transition.TRANSITION_DEACTIVATE: "deactivate",
    Transition.TRANSITION_UNCONFIGURED_SHUTDOWN: "shutdown",
    Transition.TRANSITION_INACTIVE_SHUTDOWN: "shutdown",
    Transition.TRANSITION_ACTIVE_SHUTDOWN: "shutdown",
}
_OTHERS = "who started the process configures it and shuts it down: valorctl, or a launch file"
_log = logging.getLogger("lifecycle")


class Life:
    """Moves the node through the states of its life; transitions happen in the thread that spins it.

    Attributes:
        paused: from outside: the process is to leave its work.
    """

    def __init__(self, node: LifecycleNode, pause: Callable[[], str] | None, refusal: str) -> None:
        """Unconfigured.

        Args:
            node: whose life it is.
            pause: why it cannot be paused now, empty: it can; None: it never can.
            refusal: why nobody outside is obeyed; empty: they are.
        """
        self._node, self._pause, self._refusal = node, pause, refusal
        self._ready, self._waits_for = False, "starting"
        self._active = False
        self.paused = False
        self._guard = node.create_guard_condition(self._follow)
        # rclpy's own answers would move the state machine, and nothing else.
        node._service_change_state.callback = self._change

    def configured(self) -> None:
        """All of the node's interfaces are there. Before anybody spins it."""
        self._node.trigger_configure()

    def tell(self, ready: bool, waits_for: str = "") -> None:
        """Whether the process can do its work, or what it waits for; any thread."""
        if (ready, waits_for) != (self._ready, self._waits_for):
            self._ready, self._waits_for = ready, waits_for
            self._guard.trigger()

    def finish(self) -> None:
        """The process ends; nobody spins the node any more."""
        self._ready = False
        self._follow()
        self._node.trigger_shutdown()

    def _follow(self) -> None:
        wanted = self._ready and not self.paused
        if wanted != self._active:
            self._active = wanted
            (self._node.trigger_activate if wanted else self._node.trigger_deactivate)()

    def _change(self, request: Any, response: Any) -> Any:
        transition = request.transition
        wanted = transition.label[:64] or _LABELS.get(transition.id, str(transition.id))
        reason = self._obey(wanted)
        response.success = not reason
        if reason:
            _log.warning("change_state %s refused: %s", wanted, reason)
        else:
            _log.info("%sd from outside", wanted)
        return response

    def _obey(self, wanted: str) -> str:
        """Do what is asked, or say why not."""
        if self._refusal:
            return self._refusal
        if wanted == "deactivate":
            if self._pause is None:
                return "it is active as long as what it needs is there"
            if self.paused or not self._active:
                return "it is not active"
            if why_not := self._pause():
                return why_not
            self.paused = True
        elif wanted == "activate":
            if not self.paused:
                return "it is active" if self._active else f"it waits for what it needs: {self._waits_for}"
            self.paused = False
        elif wanted in _LABELS.values():
            return _OTHERS
        else:
            return f"no transition {wanted!r}; expected activate or deactivate"
        self._follow()
        return ""
