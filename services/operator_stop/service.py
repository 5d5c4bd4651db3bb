"""The operator's page: STOP and the robot's state, above a frame with the view that ``operator_station`` serves.

STOP goes from the browser by HTTP to this process, and by Bifrost to the robot: without operator station, ROS and VRC.
Any client that can open the page can stop the robot. Requests by pages of another origin are rejected.
"""

from __future__ import annotations

import contextlib
import json
import logging
import socket
import threading
import time
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from valor.common.errors import ConfigurationError
from valor.common.linking import behind
from valor.common.topics import STATISTICS
from valor.common.viewing import LOOPBACK, own_names, page_port
from valor.operator_stop.robot import BifrostRobot
from valor.service import Context

_POLL_PERIOD = 0.1  # of the robot's state [s]
_WITHIN = 0.7  # time in which a request for a stop is answered: the page shows it within 1 s [s]
_IDLE = 2.0  # timeout of a connection without a request [s]
_CONNECTIONS = 64  # without a request, at most; a further one ends the oldest
_SILENT = 3.0  # age of the statistics without which the view is not running [s]
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "frame-ancestors 'none'",
}
_log = logging.getLogger("operator_stop")


class OperatorStop:
    """One HTTP server on the loopback interface."""

    def __init__(self, context: Context) -> None:
        """Listen; raises ``ConfigurationError`` if another process has the port."""
        self._stopping, self._statistics = context.stopping, context.statistics
        port = page_port(context.settings)
        self._robot: Any = BifrostRobot(context.node)
        if behind(context.settings):
            from valor.operator_stop.linked_robot import LinkedRobot

            self._robot = LinkedRobot(context)
        try:
            self._server = _Server(port, self._robot)
        except OSError as error:
            self._robot.close()
            raise ConfigurationError(f"port {port} of {LOOPBACK}: {error.strerror}") from None
        self._station = STATISTICS["operator_station"].subscriber(context.node)

    def run(self) -> None:
        """Serve until the process is stopped."""
        self._statistics.state("ready")
        server = threading.Thread(target=self._server.serve_forever, name="server", daemon=True)
        server.start()
        while not self._stopping.wait(_POLL_PERIOD):
            self._robot.turn()
            if (told := self._station.latest()) is not None and told.message.state == "ready":
                self._server.scene_seen = time.monotonic()
            self._statistics.idle()
        self._server.shutdown()

    def close(self) -> None:
        """Close the server."""
        self._server.server_close()
        self._robot.close()


class _Stop:
    """One stop of the robot, in a thread; ``result``: whether it is confirmed, and a text, None before its end."""

    def __init__(self, robot: Any) -> None:
        self._robot = robot
        self.result: tuple[bool, str] | None = None
        self.ended = threading.Event()
        threading.Thread(target=self._run, name="stop", daemon=True).start()

    def _run(self) -> None:
        try:
            self.result = self._robot.stop()
        except Exception as error:
            _log.exception("the stop failed")
            self.result = False, f"NOT confirmed: {error}; use the robot's own stop"
        _log.warning("%s", self.result[1])
        self.ended.set()

    def as_json(self) -> dict[str, Any]:
        confirmed, text = self.result or (False, "NOT confirmed yet: the stop is repeated")
        return {"confirmed": confirmed, "text": text}


class _Server(ThreadingHTTPServer):
    """Each connection in a thread; requests during a stop join it."""

    daemon_threads = True
    request_queue_size = 256

    def __init__(self, port: int, robot: Any) -> None:
        super().__init__((LOOPBACK, port), _Handler)
        self.names = own_names(port)
        self.page = (Path(__file__).parent / "page.html").read_text()
        self.scene_seen = float("-inf")
        self._robot = robot
        self._stop: _Stop | None = None
        self._lock = threading.Lock()
        self._idle: dict[socket.socket, None] = {}  # connections without a request, oldest first

    def process_request(self, request: Any, client_address: Any) -> None:
        """Handle a connection; too many idle ones end the oldest."""
        self._idle[request] = None
        if len(self._idle) > _CONNECTIONS and (oldest := next(iter(self._idle), None)) is not None:
            self.requested(oldest)
            with contextlib.suppress(OSError):
                oldest.shutdown(socket.SHUT_RDWR)  # its thread closes it
        super().process_request(request, client_address)

    def requested(self, connection: socket.socket) -> None:
        """Note that a connection is not idle any more."""
        self._idle.pop(connection, None)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        self.requested(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore connections that end early."""

    def state(self) -> dict[str, Any]:
        """Return the robot's state, whether the view runs, and the last stop."""
        state: dict[str, Any] = self._robot.state()
        return state | {
            "scene": time.monotonic() - self.scene_seen < _SILENT,
            "stop": self._stop and self._stop.as_json(),
        }

    def stop(self) -> dict[str, Any]:
        """Stop the robot; returns what is known of it in time."""
        with self._lock:
            if self._stop is None or self._stop.ended.is_set():
                self._stop = _Stop(self._robot)
            stop = self._stop
        stop.ended.wait(_WITHIN)
        return stop.as_json()


class _Handler(BaseHTTPRequestHandler):
    """GET /: the page; GET /state: the robot's state; POST /stop: stop."""

    server: _Server
    protocol_version = "HTTP/1.0"
    timeout = _IDLE

    def do_GET(self) -> None:
        """Reject requests of pages of another origin; answer others."""
        server, request = self.server, f"{self.command} {self.path}"
        server.requested(self.connection)
        hosts, origins = self.headers.get_all("Host", []), self.headers.get_all("Origin", [])
        if len(hosts) != 1 or hosts[0] not in server.names or origins not in ([], [f"http://{hosts[0]}"]):
            self._answer(HTTPStatus.FORBIDDEN, "not from a page of another origin", "text/plain")
        elif request == "GET /":
            self._answer(HTTPStatus.OK, server.page, "text/html")
        elif request in ("GET /state", "POST /stop"):
            known = server.stop() if self.path == "/stop" else server.state()
            self._answer(HTTPStatus.OK, json.dumps(known), "application/json")
        else:
            self._answer(HTTPStatus.NOT_FOUND, f"{request}: expected GET /, GET /state or POST /stop", "text/plain")

    def do_POST(self) -> None:
        """As ``do_GET``."""
        self.do_GET()

    def _answer(self, status: HTTPStatus, text: str, kind: str) -> None:
        body = text.encode()
        self.send_response(status)
        headers = {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body))} | _HEADERS
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *arguments: object) -> None:
        """Log nothing: stops are logged by the server."""
