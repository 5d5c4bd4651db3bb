"""Commands of the page: accepted from the operator only, while recent, and executed by one thread.

viser's threads bound the age of each user event and queue it; the station's loop processes the queue.
"""

from __future__ import annotations

import hmac
import logging
import queue
import secrets
import threading
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from viser import ClientHandle, ViserServer

from valor.common.errors import RefusalError, ValorError
from valor.operator_station.commands.log import Command, CommandLog


@dataclass
class Operator:
    """Client that may command; ``viewer`` is None while it is disconnected, ``secret`` identifies it after a reload."""

    viewer: int | None
    name: str
    secret: str


class Lease:
    """The right to command, used by one thread at a time; ``asking`` names another client that requests it."""

    def __init__(self, token: str) -> None:
        """With an empty token no client can become the operator."""
        self._token = token
        self.operator: Operator | None = None
        self.asking = ""

    def claim(self, viewer: int, name: str, token: str, *, over: bool = False) -> str:
        """Become the operator and return the secret that identifies the browser after a reload.

        Raises:
            RefusalError: wrong token, or another client operates and ``over`` is false; the request is stored.
        """
        name = name.strip()[:32] or f"viewer {viewer}"
        if not self._token or not hmac.compare_digest(token.strip().encode(), self._token.encode()):
            raise RefusalError("token", "wrong token: it stands in the file operator.token of the instance's folder")
        present = self.operator
        if present is not None and present.viewer not in (None, viewer) and not over:
            self.asking = name
            raise RefusalError("operator", f"{present.name} operates, and is told that {name} asks; or take over")
        self.asking = ""
        self.operator = Operator(viewer, name, secrets.token_urlsafe(12))
        return self.operator.secret

    def resume(self, viewer: int, secret: str) -> bool:
        """Whether the secret is that of a disconnected operator, who then has the viewer's connection."""
        present = self.operator
        if present is None or present.viewer is not None or not hmac.compare_digest(secret, present.secret):
            return False
        present.viewer = viewer
        return True

    def release(self, viewer: int) -> bool:
        """End the operation; return whether the viewer operated."""
        if not self.holds(viewer):
            return False
        self.operator, self.asking = None, ""
        return True

    def left(self, viewer: int) -> bool:
        """Mark the operator as disconnected; return whether the viewer operated."""
        if not self.holds(viewer):
            return False
        assert self.operator is not None
        self.operator.viewer = None
        return True

    def viewer(self) -> int | None:
        """Return the viewer that operates, or None."""
        return self.operator.viewer if self.operator is not None else None

    def holds(self, viewer: int) -> bool:
        """Whether the viewer operates."""
        return self.operator is not None and self.operator.viewer == viewer

    def require(self, viewer: int) -> str:
        """Return the operator's name; raises ``RefusalError`` if it is another viewer."""
        if not self.holds(viewer):
            who = f"{self.operator.name} operates" if self.operator is not None else "nobody operates"
            raise RefusalError("operator", f"you look on ({who}): show the token and take control first")
        assert self.operator is not None
        return self.operator.name

    def describe(self) -> str:
        """One line for all viewers."""
        if self.operator is None:
            return "nobody operates"
        away = " (gone; the walking pad is let go)" if self.operator.viewer is None else ""
        return f"{self.operator.name} operates{away}" + (f"; {self.asking} asks for control" if self.asking else "")


PERIOD = 0.1  # between requests [s]
MOTION = 0.5  # largest age of a repeated motion command [s]
COMMAND = 2.0  # and of any other command [s]


class Heartbeat:
    """Bounds the age of messages of one browser by its responses. Times are monotonic [s]."""

    def __init__(self, now: float) -> None:
        self._answered = now

    def answered(self, asked: float) -> None:
        """Note the response to a request sent at ``asked``."""
        self._answered = max(self._answered, asked)

    def bound(self, now: float) -> float:
        """Return the largest possible age of a message received now [s]."""
        return now - self._answered


QUESTION = "valor_operator"  # polled item of the browser's storage
AT_ONCE = 50  # events processed at most in one cycle
_PATIENCE = 5.0  # timeout of a response [s]

_log = logging.getLogger("operator_station")


@dataclass(frozen=True)
class UserEvent:
    """Event of viser, with its viewer and the bound of its age [s]."""

    viewer: int
    age: float
    event: Any


class CommandQueue:
    """Queue of user events, with the lease and the log of commands."""

    server: ViserServer  # set when it is open

    def __init__(self, token: str) -> None:
        self.lease = Lease(token)
        self.log = CommandLog()
        self._heartbeats: dict[int, Heartbeat] = {}
        self._line: queue.SimpleQueue[tuple[Callable[[UserEvent], None], UserEvent]] = queue.SimpleQueue()
        self.began: Callable[[ClientHandle], None] = lambda client: None  # called when a viewer becomes the operator
        self.ended: Callable[[], None] = lambda: None  # and when it operates no more

    def taking(
        self, act: Callable[[UserEvent], None], *, anyone: bool = False
    ) -> Callable[[Any], Coroutine[Any, Any, None]]:
        """Return a callback for viser that queues ``act``, for the operator or ``anyone``.

        It runs in the event loop, which handles messages in order: exactly the responses received earlier count.
        """
        if not anyone:
            act = self._for_operator(act)

        async def take(event: Any) -> None:
            if event.client_id is None:  # the station has set the value
                return
            viewer = int(event.client_id)
            beat = self._heartbeats.get(viewer)
            age = beat.bound(time.monotonic()) if beat is not None else float("inf")
            self._line.put((act, UserEvent(viewer, age, event)))

        return take

    def _for_operator(self, act: Callable[[UserEvent], None]) -> Callable[[UserEvent], None]:
        def checked(visit: UserEvent) -> None:
            self.lease.require(visit.viewer)
            act(visit)

        return checked

    def turn(self) -> None:
        """Process queued events."""
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

    def command(self, visit: UserEvent, text: str, oldest: float = COMMAND) -> Command:
        """Log a command; raises ``RefusalError`` if the viewer does not operate, or it is too old."""
        name = self.lease.require(visit.viewer)
        return self.log.begin(text, name, visit.age, oldest)

    def age(self) -> float:
        """Return the time since the operator's last response [s]; infinite without an operator."""
        operator = self.lease.operator
        beat = self._heartbeats.get(operator.viewer) if operator is not None and operator.viewer is not None else None
        return beat.bound(time.monotonic()) if beat is not None else float("inf")

    def notify(self, viewer: int, text: str, *, bad: bool = False) -> None:
        """Show a notification to one viewer."""
        client = self.server.get_clients().get(viewer)
        if client is not None:
            client.add_notification(
                "Refused" if bad else "Operator", text, auto_close_seconds=8.0, color="red" if bad else "blue"
            )

    def arrived(self, client: ClientHandle) -> None:
        """Add a browser; called in a separate thread."""
        now = time.monotonic()
        self._heartbeats[client.client_id] = Heartbeat(now)
        threading.Thread(target=self._question, args=(client,), name="questions", daemon=True).start()

    def departed(self, client: ClientHandle) -> None:
        """Remove a browser; called by viser's threads."""
        self._heartbeats.pop(client.client_id, None)
        self._line.put((self._left, UserEvent(client.client_id, 0.0, None)))

    def _left(self, visit: UserEvent) -> None:
        if self.lease.left(visit.viewer):
            self.ended()

    def _question(self, client: ClientHandle) -> None:
        """Poll a browser for its secret until it disconnects; the operator before a reload operates again."""
        viewer = client.client_id
        while (beat := self._heartbeats.get(viewer)) is not None:
            asked = time.monotonic()
            try:
                secret = client.local_storage.get_item(QUESTION, timeout=_PATIENCE) or ""
            except TimeoutError:
                continue
            except RuntimeError:  # disconnected, or without storage
                return
            beat.answered(asked)
            if secret and not self.lease.holds(viewer):
                self._line.put((self._resume(secret), UserEvent(viewer, 0.0, None)))
            time.sleep(PERIOD)

    def _resume(self, secret: str) -> Callable[[UserEvent], None]:
        def act(visit: UserEvent) -> None:
            if self.lease.resume(visit.viewer, secret):
                self._begin(visit.viewer, "you operate again")

        return act

    def claim(self, visit: UserEvent, name: str, token: str, *, over: bool) -> None:
        """Become the operator; raises ``RefusalError`` like ``Lease.claim``, and notifies the operator."""
        before = self.lease.operator
        try:
            secret = self.lease.claim(visit.viewer, name, token, over=over)
        except RefusalError as error:
            if error.kind == "operator" and before is not None and before.viewer is not None:
                self.notify(before.viewer, f"{self.lease.asking} asks for control: give it back, or keep it")
            raise
        if before is not None and before.viewer is not None:
            self.ended()
            if before.viewer != visit.viewer:
                self.notify(before.viewer, f"{name or 'another'} has taken over: you look on", bad=True)
        client = self.server.get_clients().get(visit.viewer)
        if client is not None:
            client.local_storage.set_item(QUESTION, secret)
        self._begin(visit.viewer, "you operate the robot")

    def _begin(self, viewer: int, text: str) -> None:
        """Give its controls to the operator."""
        if (client := self.server.get_clients().get(viewer)) is not None:
            self.began(client)
            self.notify(viewer, text)

    def release(self, visit: UserEvent) -> None:
        """End the operation by its operator."""
        if self.lease.release(visit.viewer):
            self.ended()
            self.notify(visit.viewer, "you look on")
