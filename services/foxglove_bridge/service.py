"""Forwards the topics that clients watch; the server offers no publishing, services or parameters."""

import time
from typing import Any

from valor.common.errors import ConfigurationError
from valor.common.instance import Listening
from valor.common.topics import GROUND_TRUTH
from valor.ros.node import RosSide
from valor.service import Context, quiet_collector

try:
    import foxglove

    from valor.foxglove_bridge.channels import Assets, RosChannels, Watchers
    from valor.foxglove_bridge.scene import Scene
except ModuleNotFoundError as error:
    MISSING = error.name
else:
    MISSING = None

PERIOD = 0.02  # Polling period with a client [s]
IDLE_PERIOD = 0.1  # Polling period without a client [s]
DISCOVERY_PERIOD = 1.0  # [s]
BACKLOG = 4096  # Messages queued per client; then the oldest are dropped


class FoxgloveBridge:
    """WebSocket server of Foxglove's protocol, with a ROS node for the watched topics.

    Raises ConfigurationError: the library is not installed, or the address of the settings is not available.
    """

    def __init__(self, context: Context) -> None:
        if MISSING is not None:
            raise ConfigurationError(f"{MISSING} is not installed here: pip install 'valor[foxglove]'")
        self._context, settings = context, context.settings
        self._watchers, meshes = Watchers(), Assets()
        channels = foxglove.Context()
        name = f"valor {context.instance.name}"
        self._server = _serve(settings.foxglove, name, channels, self._watchers, meshes)
        self._side = RosSide(context.name, settings, context.instance.environment(), context.arguments, sim_time=False)
        self._channels = RosChannels(self._side.node, channels, meshes)
        truth = GROUND_TRUTH.subscriber(context.node) if settings.variant == "simulation" else None
        self._scene = Scene(self._side.node, channels, settings, context.robot, truth)
        self._side.life.configure()
        self._address = f"ws://{settings.foxglove.host}:{self._server.port}"

    def run(self) -> None:
        """Serve until stopped."""
        self._channels.discover()
        quiet_collector()
        statistics, watched = self._context.statistics, frozenset[int]()
        next_discovery = time.monotonic() + DISCOVERY_PERIOD
        while not self._context.stopping.wait(PERIOD if watched else IDLE_PERIOD):
            began = time.perf_counter()
            if time.monotonic() >= next_discovery:
                next_discovery = time.monotonic() + DISCOVERY_PERIOD
                self._channels.discover()
                looking = self._watchers.clients
                self._side.life.set_ready(True)
                self._side.serve_pending()
                statistics.state("ready", f"{self._address}: {looking} looking")
            watched, new = self._watchers.look()
            self._channels.follow(watched, new)
            self._scene.follow(watched, new)
            if self._channels.forward() + self._scene.show():
                statistics.cycle(began)
            else:
                statistics.idle()

    def close(self) -> None:
        """Close the server and the ROS node."""
        self._server.stop()
        self._side.close()


def _serve(where: Listening, name: str, channels: Any, watchers: Any, meshes: Any) -> Any:
    try:
        return foxglove.start_server(
            name=name, host=where.host, port=where.port, context=channels, server_listener=watchers, capabilities=[],
            asset_handler=meshes.read, message_backlog_size=BACKLOG,
        )  # fmt: skip
    except RuntimeError as error:
        raise ConfigurationError(
            f"{where.host}:{where.port}: {error}; expected an address of this computer and a free port: "
            "up --foxglove-at [HOST:]PORT"
        ) from None
