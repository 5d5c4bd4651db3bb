"""Where commands of the page are taken: by one thread, of the one operator, and only while they are new.

What a browser sends arrives in viser's threads; there it is stamped with how old it may be, and put in line. The
station's loop takes it from there, so that everything else knows one thread alone.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from viser import ClientHandle, ViserServer

from valor.common.errors import RefusalError, ValorError
from valor.operator_station.commands import Command, CommandLog
from valor.operator_station.heartbeat import COMMAND, PERIOD, Heartbeat
from valor.operator_station.lease import Lease

QUESTION = "valor_operator"  # the item of the browser's storage that is asked for, again and again
AT_ONCE = 50  # of what waits, in one turn
_PATIENCE = 5.0  # with an answer, until it is asked again [s]

_log = logging.getLogger("operator_station")


@dataclass(frozen=True)
class Visit:
    """Something that a viewer did.

    Attributes:
        viewer: the connection's number.
        age: at most so old [s].
        event: viser's.
    """

    viewer: int
    age: float
    event: Any


class Desk:
    """Takes commands.

    Attributes:
        lease: who operates.
        log: what was commanded.
    """

    def __init__(self, server: ViserServer, token: str) -> None:
        self._server = server
        self.lease = Lease(token)
        self.log = CommandLog()
        self._heartbeats: dict[int, Heartbeat] = {}
        self._line: queue.SimpleQueue[tuple[Callable[[Visit], None], Visit]] = queue.SimpleQueue()
        self.gone: list[Callable[[], None]] = []  # called when the operator is

    def taking(self, act: Callable[[Visit], None]) -> Callable[[Any], Coroutine[Any, Any, None]]:
        """A callback for viser that has ``act`` called by the loop.

        It runs in the event loop, where messages are handled in the order in which they came: whatever answer came
        before has been counted, and none that came behind.
        """

        async def take(event: Any) -> None:
            viewer = int(event.client_id)
            beat = self._heartbeats.get(viewer)
            age = beat.bound(time.monotonic()) if beat is not None else float("inf")
            self._line.put((act, Visit(viewer, age, event)))

        return take

    def turn(self) -> None:
        """Do what waits."""
        for _ in range(AT_ONCE):
            try:
                act, visit = self._line.get_nowait()
            except queue.Empty:
                return
            try:
                act(visit)
            except ValorError as error:
                self.notify(visit.viewer, str(error), bad=True)
            except Exception:
                _log.exception("what a viewer asked for failed")
                self.notify(visit.viewer, "that failed; the station's log says why", bad=True)

    def command(self, visit: Visit, text: str, oldest: float = COMMAND) -> Command:
        """A command that may be given now.

        Raises:
            RefusalError: who asks does not operate, or it came too late.
        """
        name = self.lease.require(visit.viewer)
        return self.log.begin(text, name, visit.age, time.monotonic(), oldest)

    def age(self) -> float:
        """How old the operator's last sign of life is [s]; infinite: nobody operates."""
        operator = self.lease.operator
        beat = self._heartbeats.get(operator.viewer) if operator is not None and operator.viewer is not None else None
        return beat.bound(time.monotonic()) if beat is not None else float("inf")

    def notify(self, viewer: int, text: str, *, bad: bool = False) -> None:
        """Tell one viewer."""
        client = self._server.get_clients().get(viewer)
        if client is not None:
            client.add_notification(
                "Refused" if bad else "Operator", text, auto_close_seconds=8.0, color="red" if bad else "blue"
            )

    def arrived(self, client: ClientHandle) -> None:
        """A browser is there; from a thread of its own."""
        now = time.monotonic()
        self._heartbeats[client.client_id] = Heartbeat(now)
        threading.Thread(target=self._question, args=(client,), name="questions", daemon=True).start()

    def departed(self, client: ClientHandle) -> None:
        """A browser is gone; from one of viser's threads."""
        self._heartbeats.pop(client.client_id, None)
        self._line.put((self._left, Visit(client.client_id, 0.0, None)))

    def _left(self, visit: Visit) -> None:
        if self.lease.left(visit.viewer):
            for each in self.gone:
                each()

    def _question(self, client: ClientHandle) -> None:
        """Ask a browser for its secret until it is gone: who was the operator before a reload is again."""
        viewer = client.client_id
        while (beat := self._heartbeats.get(viewer)) is not None:
            asked = time.monotonic()
            try:
                secret = client.local_storage.get_item(QUESTION, timeout=_PATIENCE) or ""
            except TimeoutError:
                continue
            except RuntimeError:  # it is gone, or keeps nothing
                return
            beat.answered(asked)
            if secret and not self.lease.holds(viewer):
                self._line.put((self._resume(secret), Visit(viewer, 0.0, None)))
            time.sleep(PERIOD)

    def _resume(self, secret: str) -> Callable[[Visit], None]:
        def act(visit: Visit) -> None:
            if self.lease.resume(visit.viewer, secret):
                self.notify(visit.viewer, "you operate again")

        return act

    def claim(self, visit: Visit, name: str, token: str, *, over: bool) -> None:
        """Become the operator.

        Raises:
            RefusalError: as of ``Lease.claim``; the operator is told who asks.
        """
        before = self.lease.operator
        try:
            secret = self.lease.claim(visit.viewer, name, token, over=over)
        except RefusalError as error:
            if error.kind == "operator" and before is not None and before.viewer is not None:
                self.notify(before.viewer, f"{self.lease.asking} asks for control: give it back, or keep it")
            raise
        if before is not None and before.viewer not in (None, visit.viewer):
            for each in self.gone:
                each()
            assert before.viewer is not None
            self.notify(before.viewer, f"{name or 'another'} has taken over: you look on", bad=True)
        client = self._server.get_clients().get(visit.viewer)
        if client is not None:
            client.local_storage.set_item(QUESTION, secret)
        self.notify(visit.viewer, "you operate the robot")
