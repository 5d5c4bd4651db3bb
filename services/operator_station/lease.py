"""Who operates: one viewer at a time, who has shown the token. All others look on, and may ask."""

from __future__ import annotations

import hmac
import secrets
from dataclasses import dataclass

from valor.common.errors import RefusalError


@dataclass
class Operator:
    """The one who operates.

    Attributes:
        viewer: the connection that is theirs; None: it is gone, the operator with it.
        name: as they called themselves.
        secret: by which their browser is known again after a reload.
    """

    viewer: int | None
    name: str
    secret: str


class Lease:
    """The right to command. From one thread at a time.

    Attributes:
        operator: who has it; None: nobody.
        asking: the name of who asked for it while another had it; empty: nobody.
    """

    def __init__(self, token: str) -> None:
        """``token``: what an operator must show; empty: nobody can become one."""
        self._token = token
        self.operator: Operator | None = None
        self.asking = ""

    def claim(self, viewer: int, name: str, token: str, *, over: bool = False) -> str:
        """Become the operator.

        Args:
            viewer: the connection.
            name: what the others shall call them.
            token: to be shown.
            over: take it from who has it.

        Returns:
            The secret by which the browser is known again.

        Raises:
            RefusalError: the token is wrong, or another one operates: who is told that somebody asks.
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
        """The operator's browser is back: whether it is known. One that another connection has is not."""
        present = self.operator
        if present is None or present.viewer is not None or not hmac.compare_digest(secret, present.secret):
            return False
        present.viewer = viewer
        return True

    def release(self, viewer: int) -> bool:
        """Give it back; whether it was theirs."""
        if not self.holds(viewer):
            return False
        self.operator, self.asking = None, ""
        return True

    def left(self, viewer: int) -> bool:
        """A connection is gone; whether it was the operator's. The lease waits for them until somebody claims it."""
        if not self.holds(viewer):
            return False
        assert self.operator is not None
        self.operator.viewer = None
        return True

    def holds(self, viewer: int) -> bool:
        """Whether a viewer operates."""
        return self.operator is not None and self.operator.viewer == viewer

    def require(self, viewer: int) -> str:
        """The operator's name.

        Raises:
            RefusalError: it is not this viewer.
        """
        if not self.holds(viewer):
            who = f"{self.operator.name} operates" if self.operator is not None else "nobody operates"
            raise RefusalError("operator", f"you look on ({who}): show the token and take control first")
        assert self.operator is not None
        return self.operator.name

    def describe(self) -> str:
        """One line for everybody."""
        if self.operator is None:
            return "nobody operates"
        away = " (gone; the walking pad is let go)" if self.operator.viewer is None else ""
        return f"{self.operator.name} operates{away}" + (f"; {self.asking} asks for control" if self.asking else "")
