"""The door of a page that is served beyond this computer: real TLS, a real server behind it."""

from __future__ import annotations

import http.client
import socket
import ssl
import stat
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import pytest
from websockets.sync.client import connect
from websockets.sync.server import ServerConnection, serve

from valor.common.errors import ConfigurationError
from valor.door import door as doors
from valor.door.admission import Admission
from valor.door.certificate import context, fingerprint, self_made
from valor.door.door import Door

VIEWER, HELD, OPERATOR, COOKIE = "look on", "look%20on", "drive-it", "valor_8080"
HERE = "127.0.0.1"


class Inside(BaseHTTPRequestHandler):
    """Says what it was asked, and by whom."""

    def do_GET(self) -> None:
        server: Any = self.server
        server.asked.append((self.command, self.path, dict(self.headers)))
        body = self.path.encode() * 1000
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    do_POST = do_GET  # noqa: N815

    def log_message(self, format: str, *arguments: object) -> None:
        pass


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("home") / "viewing.pem"
    self_made(file, HERE)
    return file


@pytest.fixture(scope="module")
def inside() -> Iterator[Any]:
    server: Any = ThreadingHTTPServer((HERE, 0), Inside)
    server.asked = []
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()


@pytest.fixture(scope="module")
def door(certificate: Path, inside: Any) -> Iterator[Door]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(doors, "SLOW", 0.01)
        made = opened(certificate, inside.server_address[1], {"/stop-button": 8081})
        yield made
        made.close()


def opened(certificate: Path, port: int, elsewhere: dict[str, int] | None = None) -> Door:
    return Door((HERE, 0), context(certificate), Admission(COOKIE, VIEWER, [OPERATOR]), port, elsewhere)


def trusting(certificate: Path) -> ssl.SSLContext:
    """As of a browser whose person has compared the fingerprint."""
    return ssl.create_default_context(cafile=str(certificate))


def ask(
    door: Door, certificate: Path, path: str = "/", method: str = "GET", body: str = "", **headers: str
) -> http.client.HTTPResponse:
    line = http.client.HTTPSConnection(HERE, door.port, context=trusting(certificate), timeout=30.0)
    line.request(method, path, body or None, {name.title(): value for name, value in headers.items()})
    return line.getresponse()


def admitted(**headers: str) -> dict[str, str]:
    return {"cookie": f"{COOKIE}={HELD}", **headers}


def test_a_plain_connection_is_refused_with_a_word(door: Door, inside: Any) -> None:
    line = http.client.HTTPConnection(HERE, door.port, timeout=30.0)
    line.request("GET", "/", headers=admitted())
    answer = line.getresponse()
    assert answer.status == 426
    assert f"https://{HERE}:{door.port}/" in answer.read().decode()
    assert inside.asked == []


def test_who_shows_no_token_comes_no_further_than_the_form(door: Door, certificate: Path, inside: Any) -> None:
    for cookie in ("", f"{COOKIE}=", f"{COOKIE}={OPERATOR}", f"other={HELD}", "=;=", f"{COOKIE}={HELD}x"):
        answer = ask(door, certificate, "/index.html", cookie=cookie)
        assert answer.status == 403
        assert "token" in answer.read().decode()
    for token in ("", "wrong", f"{VIEWER} {OPERATOR}"):
        answer = ask(door, certificate, "/login", "POST", urlencode({"token": token}))
        assert answer.status == 403
        assert answer.getheader("Set-Cookie") is None
    assert ask(door, certificate, "/login", "POST", "x" * 5000).status == 413
    assert inside.asked == []


@pytest.mark.parametrize("token", [VIEWER, OPERATOR, f" {VIEWER}\n"])
def test_a_token_opens_and_the_cookie_does_not_tell_the_operators(token: str, door: Door, certificate: Path) -> None:
    answer = ask(door, certificate, "/login", "POST", urlencode({"token": token}))
    assert (answer.status, answer.getheader("Location")) == (303, "/")
    cookie = str(answer.getheader("Set-Cookie"))
    assert OPERATOR not in cookie
    assert all(word in cookie for word in ("Secure", "HttpOnly", "SameSite=Strict"))
    shown = ask(door, certificate, "/a", cookie=cookie.partition(";")[0])
    assert (shown.status, shown.read()) == (200, b"/a" * 1000)


def test_the_server_inside_is_called_by_its_own_name_and_told_no_cookie(
    door: Door, certificate: Path, inside: Any
) -> None:
    answer = ask(door, certificate, "/stop", "POST", **admitted(origin=f"https://{HERE}:{door.port}"))
    assert answer.status == 200
    method, path, headers = inside.asked[-1]
    own = f"{HERE}:{inside.server_address[1]}"
    assert (method, path, headers["Host"], headers["Origin"]) == ("POST", "/stop", own, f"http://{own}")
    assert "Cookie" not in headers


def test_a_page_of_another_origin_is_refused_with_the_cookie_too(door: Door, certificate: Path, inside: Any) -> None:
    before = len(inside.asked)
    for origin in ("https://evil.example", f"http://{HERE}:{door.port}", "null"):
        assert ask(door, certificate, "/stop", "POST", **admitted(origin=origin)).status == 403
    assert len(inside.asked) == before


def test_the_stop_button_is_at_its_own_door(door: Door, certificate: Path) -> None:
    answer = ask(door, certificate, "/stop-button", **admitted(host=f"robot.lab:{door.port}"))
    assert (answer.status, answer.getheader("Location")) == (307, "https://robot.lab:8081/")
    assert ask(door, certificate, "/stop-button").status == 403


def test_a_second_request_on_the_same_line_is_not_heard(door: Door, certificate: Path, inside: Any) -> None:
    """The head that was looked at is the only one that is passed on."""
    before = len(inside.asked)
    with (
        socket.create_connection((HERE, door.port)) as plain,
        trusting(certificate).wrap_socket(plain, server_hostname=HERE) as line,
    ):
        head = f"GET /one HTTP/1.1\r\nHost: {HERE}\r\nCookie: {COOKIE}={HELD}\r\n\r\n"
        line.sendall(f"{head}GET /two HTTP/1.1\r\nHost: {HERE}\r\nOrigin: https://evil.example\r\n\r\n".encode())
        heard = b""
        while data := line.recv(65536):
            heard += data
    assert heard.endswith(b"/one" * 1000)
    assert [path for _, path, _ in inside.asked[before:]] == ["/one"]


def test_whatever_else_comes_the_door_goes_on(door: Door, certificate: Path) -> None:
    for said in (b"", b"\x16", b"\x16\x03\x01\x00\x05hello", b"\x00\xff"):
        with socket.create_connection((HERE, door.port)) as line:
            line.sendall(said)
    for head in (b"\r\n\r\n", b"GET\r\n\r\n", b"GET / HTTP/2\r\n\r\n", b"GET \xff HTTP/1.1\r\n\r\n", b"x" * 100_000):
        with (
            socket.create_connection((HERE, door.port)) as plain,
            trusting(certificate).wrap_socket(plain, server_hostname=HERE) as line,
        ):
            line.settimeout(30.0)
            try:
                line.sendall(head)
                assert not line.recv(100)
            except OSError:
                pass
    assert ask(door, certificate, "/", **admitted()).status == 200


def test_websockets_go_through_both_ways(certificate: Path) -> None:
    def echo(line: ServerConnection) -> None:
        for message in line:
            line.send(message)

    with serve(echo, HERE, 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        door = opened(certificate, server.socket.getsockname()[1])
        url, held = f"wss://{HERE}:{door.port}/", {"Cookie": f"{COOKIE}={HELD}"}
        with connect(url, ssl=trusting(certificate), additional_headers=held) as line:
            for message in (b"x" * 300_000, "ö", b""):
                line.send(message)
                assert line.recv(30.0) == message
        with pytest.raises(Exception, match="403"):
            connect(url, ssl=trusting(certificate))
        door.close()
        server.shutdown()
        thread.join()


def test_a_certificate_of_our_own_is_kept_and_made_anew_for_another_name(tmp_path: Path, inside: Any) -> None:
    file = tmp_path / "viewing.pem"
    self_made(file, "127.0.0.2")
    first = fingerprint(file)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    self_made(file, "127.0.0.2")
    assert fingerprint(file) == first
    door = opened(file, inside.server_address[1])
    seen = ssl.get_server_certificate((HERE, door.port))
    door.close()
    other = tmp_path / "seen.pem"
    other.write_text(seen)
    assert fingerprint(other) == first
    self_made(file, "robot.lab")
    assert fingerprint(file) != first
    file.write_text("nonsense")
    with pytest.raises(ConfigurationError, match=r"viewing\.pem: no certificate; expected a PEM file"):
        fingerprint(file)
    with pytest.raises(ConfigurationError, match="expected a PEM file"):
        context(file)
    self_made(file, "robot.lab")
    context(file)


def test_an_address_that_is_not_ours_or_a_port_that_is_taken_is_told(certificate: Path, door: Door) -> None:
    admission = Admission(COOKIE, VIEWER)
    for at in ((HERE, door.port), ("192.0.2.1", 0)):
        with pytest.raises(ConfigurationError, match=f"port {at[1]} of {at[0]}"):
            Door(at, context(certificate), admission, 1)


def test_without_tokens_nobody_is_let_in(certificate: Path, inside: Any) -> None:
    door = Door((HERE, 0), context(certificate), Admission(COOKIE, "", [""]), inside.server_address[1])
    assert ask(door, certificate, "/login", "POST", urlencode({"token": ""})).status == 403
    assert ask(door, certificate, "/", cookie=f"{COOKIE}=").status == 403
    door.close()
