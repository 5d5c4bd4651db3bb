"""Serves the button and does what it says: from the browser over HTTP to here, and over Bifrost to the robot.

Neither the operator station, nor ROS, nor the Valor ROS Controller is on the way. Whoever sees the page may stop the
robot; nobody can do anything else here. A page of somebody else's in the same browser is refused: its ``Origin``, or
the ``Host`` it came by, is another.
"""

from __future__ import annotations

import logging
import threading
import time
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import bifrost
from valor.common.errors import ConfigurationError
from valor.common.stopping import HALT, MotionSystem
from valor.common.viewing import LOOPBACK, Viewing, own_names, stop_port
from valor.door.serving import Guard, inside
from valor.operator_stop.page import PAGE
from valor.service import Context

_LOOK = 0.25  # [s]
_log = logging.getLogger("operator_stop")


class OperatorStop:
    """One HTTP server on the loopback interface; beyond it behind a door of its own."""

    def __init__(self, context: Context) -> None:
        """Listen.

        Raises:
            ConfigurationError: the port is another's.
        """
        self._stopping, self._statistics = context.stopping, context.statistics
        port = stop_port(context.settings)
        within = inside(Viewing.of(context.instance), port)
        try:
            self._server = _Server(within, context.node)
        except OSError as error:
            raise ConfigurationError(f"port {within} of {LOOPBACK}: {error.strerror}") from None
        self._guard = Guard(context.instance, context.settings, port, within)

    def run(self) -> None:
        """Serve until told to stop."""
        self._statistics.state("ready")
        while not self._stopping.is_set():
            self._server.handle_request()
            self._statistics.idle()

    def close(self) -> None:
        """Listen no longer."""
        self._guard.close()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    """Each request in a thread; one stop at a time."""

    timeout = _LOOK
    daemon_threads = True

    def __init__(self, port: int, node: bifrost.Node) -> None:
        super().__init__((LOOPBACK, port), _Handler)
        self.names = own_names(port)
        self._node = node
        self._one = threading.Lock()

    def stop_robot(self) -> tuple[bool, str]:
        """Whether the robot is confirmed to have stopped, and what to say."""
        began = time.monotonic()
        with self._one, MotionSystem(self._node, HALT, began) as system:
            system.advance()
            while not (state := system.confirmed()) and time.monotonic() - began < HALT.longest:
                system.wait()
                system.advance()
            after = time.monotonic() - began
            text = (
                f"stopped after {after:.2f} s: {state}" if state else f"not confirmed to have stopped: {system.seen()}"
            )
        _log.warning("%s", text)
        return bool(state), text


class _Handler(BaseHTTPRequestHandler):
    """GET: the page; POST /stop: stop."""

    server: _Server
    protocol_version = "HTTP/1.0"

    def do_GET(self) -> None:
        """The page."""
        if self._own():
            self._answer(HTTPStatus.OK, PAGE, "text/html")

    def do_HEAD(self) -> None:
        """Whether anybody is there."""
        self.do_GET()

    def do_POST(self) -> None:
        """Stop the robot."""
        if not self._own():
            return
        if self.path != "/stop":
            self._answer(HTTPStatus.NOT_FOUND, f"{self.path}: expected /stop", "text/plain")
            return
        stopped, text = self.server.stop_robot()
        self._answer(HTTPStatus.OK if stopped else HTTPStatus.SERVICE_UNAVAILABLE, text, "text/plain")

    def _own(self) -> bool:
        """Whether the request is of our own page, by the names under which we are reached; else it is refused."""
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        if host in self.server.names and origin in (None, f"http://{host}"):
            return True
        self._answer(HTTPStatus.FORBIDDEN, "not from a page of another origin", "text/plain")
        return False

    def _answer(self, status: HTTPStatus, text: str, kind: str) -> None:
        body = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, format: str, *arguments: object) -> None:
        """Requests are no news; stops are logged."""
