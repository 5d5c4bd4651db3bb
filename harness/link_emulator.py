"""A bad link between the two ends, as a program: ``python -m harness.link_emulator --to 8480 --listen 9000``.

The operator's end sends to ``--listen`` (slow channel) and the port after it (fast), which go on to ``--to`` and the
port after it, and back, as badly as asked for.
"""

from __future__ import annotations

import argparse
import contextlib
import heapq
import itertools
import selectors
import socket
import threading
import time

from harness.emulated_channel import (
    DRC_FAST,
    DRC_SLOW,
    Bandwidth,
    Conditions,
    EmulatedChannel,
    Windows,
    drc_windows,
    random_windows,
)
from valor.link.udp_transport import Address

HOST = "127.0.0.1"
LONGEST = 2048  # datagram [B]
TURN = 64  # datagrams of one socket processed before the next socket
BUFFER = 4 * 2**20  # of a port [B]
_Flight = tuple[float, int, socket.socket, Address, bytes]


class Emulator:
    """Carries datagrams between the two ends, in a thread of its own.

    Attributes:
        listening: port where the operator's end finds the slow channel; the fast one is the next.
        lines: of the slow channel, to the robot and from it, then of the fast one.
        cut: while true nothing passes.
        to: ports of the robot's end; 0: it is not there yet.
    """

    def __init__(
        self,
        to: tuple[int, int],
        slow: Conditions,
        fast: Conditions,
        *,
        windows: Windows = (),
        seed: int = 0,
        listen: int = 0,
        here: str = HOST,
        robot: str = HOST,
    ) -> None:
        """Begin.

        Args:
            to: ports of the robot's end.
            slow: of the slow channel, either way; both ways share the bandwidth.
            fast: of the fast one.
            windows: when the fast one is there, from now on [s].
            seed: of all that is random.
            listen: port of the slow channel; 0: any that is free, and the next one, too.
            here: address of this computer where the operator's end finds it.
            robot: address of the robot's end.
        """
        self.to, self._robot = to, robot
        self._fronts = _neighbours(here, listen)
        self._backs = [_socket(HOST if robot == HOST else "", 0) for _ in to]
        self.listening = int(self._fronts[0].getsockname()[1])
        shared = Bandwidth(slow)
        self.lines = [
            EmulatedChannel(slow, seed, None, shared), EmulatedChannel(slow, seed + 1, None, shared),
            EmulatedChannel(fast, seed + 2, windows), EmulatedChannel(fast, seed + 3, windows),
        ]  # fmt: skip
        self.cut = False
        self._callers: dict[int, Address] = {}
        self._flying: list[_Flight] = []
        self._order = itertools.count()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._carry, name="emulator", daemon=True)
        self._thread.start()

    def _carry(self) -> None:
        began = time.monotonic()
        with selectors.DefaultSelector() as selector:
            for channel in (0, 1):
                selector.register(self._fronts[channel], selectors.EVENT_READ, (channel, True))
                selector.register(self._backs[channel], selectors.EVENT_READ, (channel, False))
            while not self._closing.is_set():
                due = self._flying[0][0] - time.monotonic() if self._flying else 0.1
                for key, _ in selector.select(min(max(due, 0.0), 0.1)):
                    channel, to_robot = key.data
                    for _ in range(TURN):
                        if not self._take(channel, to_robot, began):
                            break
                self._send(time.monotonic())

    def _take(self, channel: int, to_robot: bool, began: float) -> bool:
        """Process one datagram of a socket; False if there is none."""
        try:
            data, address = (self._fronts if to_robot else self._backs)[channel].recvfrom(LONGEST)
        except OSError:
            return False
        if to_robot:
            self._callers[channel] = address
            sender, to = self._backs[channel], (self._robot, self.to[channel])
        else:
            sender, to = self._fronts[channel], self._callers.get(channel, (HOST, 0))
        if self.cut or not to[1]:
            return True
        emulated, now = self.lines[2 * channel + (not to_robot)], time.monotonic() - began
        for arrival in emulated.put(len(data), now):
            heapq.heappush(self._flying, (began + arrival, next(self._order), sender, to, data))
        return True

    def _send(self, now: float) -> None:
        """Send due datagrams."""
        while self._flying and self._flying[0][0] <= now:
            _, _, sender, to, data = heapq.heappop(self._flying)
            with contextlib.suppress(OSError):  # no process listens, or the buffer is full
                sender.sendto(data, to)

    def close(self) -> None:
        """Carry nothing any more."""
        self._closing.set()
        self._thread.join()
        for each in (*self._fronts, *self._backs):
            each.close()


def _neighbours(address: str, port: int) -> list[socket.socket]:
    """Two with neighbouring ports."""
    for _ in range(50):
        first = _socket(address, port)
        try:
            return [first, _socket(address, first.getsockname()[1] + 1)]
        except OSError:
            first.close()
            if port:
                raise
    raise OSError("no two free ports side by side")


def _socket(address: str, port: int) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    for which in (socket.SO_RCVBUF, socket.SO_SNDBUF):
        made.setsockopt(socket.SOL_SOCKET, which, BUFFER)
    made.bind((address, port))
    return made


def _place(text: str) -> tuple[str, int]:
    address, _, port = text.rpartition(":")
    return address or HOST, int(port)


def main() -> None:
    """Until interrupted."""
    parser = argparse.ArgumentParser(description=__doc__)
    for option, which in (("--listen", "the operator's end sends here"), ("--to", "the robot's end listens here")):
        parser.add_argument(
            option, type=_place, required=True, metavar="[ADDRESS:]PORT", help=f"{which}, and one higher"
        )
    parser.add_argument("--seed", type=int, help="of what is random, and of blackouts in place of DARPA's example")
    for name in ("bandwidth", "delay", "jitter", "loss", "duplication", "reordering"):
        default = getattr(DRC_SLOW, name)
        parser.add_argument(f"--{name}", type=float, default=default, help=f"of the slow channel [{default}]")
    asked = vars(parser.parse_args())
    (here, listen), (robot, to), seed = asked.pop("listen"), asked.pop("to"), asked.pop("seed")
    windows = drc_windows() if seed is None else random_windows(seed, 24 * 3600.0)
    places = {"listen": listen, "here": here, "robot": robot}
    emulator = Emulator((to, to + 1), Conditions(**asked), DRC_FAST, windows=windows, seed=seed or 0, **places)
    try:
        while True:
            time.sleep(1.0)
            print("  ".join(f"{line.passed} B passed, {line.lost} lost" for line in emulator.lines), flush=True)
    except KeyboardInterrupt:
        emulator.close()


if __name__ == "__main__":
    main()
