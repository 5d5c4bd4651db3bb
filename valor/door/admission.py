"""Who is let in: whoever shows a token once has a cookie from then on; all else is refused with a word."""

from __future__ import annotations

import hmac
import html
from collections.abc import Iterable
from dataclasses import dataclass
from email.message import Message
from http import HTTPStatus
from http.client import HTTPException, parse_headers
from http.cookies import CookieError, SimpleCookie
from io import BytesIO
from urllib.parse import parse_qs, quote

LOGIN = "/login"
_FORM = """<!doctype html><html lang="en"><meta charset="utf-8"><title>valor</title>
<style>body { font: 16px system-ui, sans-serif; margin: 3em auto; max-width: 26em }</style>
<h1>valor</h1><p>%s</p>
<form method="post" action="/login"><input name="token" type="password" autofocus aria-label="token">
<button>Show it</button></form></html>
"""


@dataclass(frozen=True)
class Request:
    """The head of one.

    Attributes:
        method: GET, POST, …
        target: path and query.
        headers: as they came.
    """

    method: str
    target: str
    headers: Message

    @classmethod
    def of(cls, head: bytes) -> Request:
        """Of bytes up to the empty line.

        Raises:
            ValueError: it is none of HTTP/1.
        """
        line, _, rest = head.partition(b"\r\n")
        method, target, version = line.decode("ascii").split(" ")
        if not version.startswith("HTTP/1.") or not target.startswith("/"):
            raise ValueError(line)
        try:
            return cls(method, target, parse_headers(BytesIO(rest)))
        except HTTPException as error:
            raise ValueError(str(error)) from None

    @property
    def host(self) -> str:
        """By which name we were called."""
        return str(self.headers.get("Host", ""))

    @property
    def upgrades(self) -> bool:
        """Whether it is to become a WebSocket."""
        return str(self.headers.get("Upgrade", "")).lower() == "websocket"

    @property
    def length(self) -> int:
        """Of the body [B]; −1: it does not say so in a way that is understood."""
        told = str(self.headers.get("Content-Length", "0"))
        return int(told) if told.isdecimal() and "Transfer-Encoding" not in self.headers else -1


class Admission:
    """Knows tokens and the cookie."""

    def __init__(self, cookie: str, viewer: str, others: Iterable[str] = ()) -> None:
        """``viewer``: the token that the cookie holds; ``others`` let in, too. Empty ones let nobody in."""
        self._cookie, self._viewer, self._held = cookie, viewer, quote(viewer, safe="")
        self._tokens = [token for token in (viewer, *others) if token]

    def knows(self, request: Request) -> bool:
        """Whether it has the cookie."""
        try:
            cookies = SimpleCookie(str(request.headers.get("Cookie", "")))
        except CookieError:
            return False
        held = cookies.get(self._cookie)
        return bool(self._viewer) and held is not None and _same(held.value, self._held)

    def shown(self, form: bytes) -> bool:
        """Whether a form shows a token."""
        told = parse_qs(form.decode("ascii", "replace")).get("token", [""])[0].strip()
        return any(_same(told, token) for token in self._tokens)

    def welcome(self) -> bytes:
        """To the page, with the cookie; never sent without TLS, nor to pages of others."""
        cookie = f"{self._cookie}={self._held}; Path=/; Secure; HttpOnly; SameSite=Strict"
        return answer(HTTPStatus.SEE_OTHER, "", headers=(("Location", "/"), ("Set-Cookie", cookie)))


def own_origin(request: Request) -> bool:
    """Whether it comes from a page of ours, or from none."""
    return request.headers.get("Origin") in (None, f"https://{request.host}")


def form(wrong: bool = False) -> bytes:
    """Where a token is shown."""
    word = "That is no token of this robot's. " if wrong else ""
    asked = "Show the viewers' token, or the operator's: `valorctl view` said them."
    return answer(HTTPStatus.FORBIDDEN, _FORM % html.escape(word + asked), "text/html")


def answer(status: HTTPStatus, text: str, kind: str = "text/plain", headers: Iterable[tuple[str, str]] = ()) -> bytes:
    """A whole one; the connection ends with it."""
    body = text.encode()
    lines = [
        f"HTTP/1.1 {status.value} {status.phrase}",
        *(f"{name}: {value}" for name, value in headers),
        f"Content-Type: {kind}; charset=utf-8",
        f"Content-Length: {len(body)}",
        "Cache-Control: no-store",
        "Connection: close",
    ]
    return "\r\n".join(lines).encode() + b"\r\n\r\n" + body


def _same(one: str, other: str) -> bool:
    return hmac.compare_digest(one.encode(), other.encode())
