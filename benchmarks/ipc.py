"""One-way latency and CPU time of Bifrost against bare pyzmq over TCP, with and without CURVE, in one run.

    python benchmarks/ipc.py [--rate 500] [--seconds 4]

Two processes: this one publishes, a child subscribes and stamps each message as soon as it is decoded. Bare pyzmq sends
as many bytes as the Bifrost payload has, behind an eight-byte stamp, and decodes nothing. CPU time is that of both
processes, all threads, a message; a publisher and a subscriber that idle at the same rate are the "idle" rows.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from struct import Struct

import numpy as np
import zmq

import bifrost

JOINTS = 38
STAMP = Struct("<q")
ROW = "{:<24}{:<16}{:>9}{:>9}{:>9}{:>9}{:>12}{:>7}"


class Number(bifrost.Message):
    """The thesis' message: a single double."""

    value: float


class Proprioceptor(bifrost.Message):
    """As large as the robot's, 38 joints."""

    time: int
    sequence: int
    motor_sequence: int
    joint_position: bifrost.Float64Array
    joint_velocity: bifrost.Float64Array
    joint_effort: bifrost.Float64Array
    imu_orientation: bifrost.Float64Array
    imu_angular_velocity: bifrost.Float64Array
    imu_linear_acceleration: bifrost.Float64Array
    left_foot_wrench: bifrost.Float64Array
    right_foot_wrench: bifrost.Float64Array
    left_hand_wrench: bifrost.Float64Array
    right_hand_wrench: bifrost.Float64Array
    battery_voltage: float


class Blob(bifrost.Message):
    """64 kB."""

    data: bifrost.Uint8Array


def _proprioceptor() -> Proprioceptor:
    vectors = [np.random.default_rng(0).normal(size=n) for n in (*3 * (JOINTS,), 4, 3, 3, 6, 6, 6, 6)]
    return Proprioceptor(1, 2, 3, *vectors, battery_voltage=48.0)


MESSAGES: dict[str, bifrost.Message] = {
    "8 B": Number(1.0),
    "Proprioceptor": _proprioceptor(),
    "64 kB": Blob(np.zeros(65536, np.uint8)),
}
TRANSPORTS = ("bifrost latest", "bifrost queue", "pyzmq", "pyzmq CURVE", "idle")


def _paced(publish: Callable[[], object], rate: float, count: int) -> float:
    """Call at a rate; returns the CPU time spent [s]."""
    cpu = time.process_time()
    due = time.monotonic()
    for _ in range(count):
        publish()
        due += 1.0 / rate
        time.sleep(max(0.0, due - time.monotonic()))
    return time.process_time() - cpu


def receive(transport: str, message: str, endpoint: str, count: int) -> None:
    """The child: print what it measured as JSON."""
    latencies: list[int] = []
    now = time.monotonic_ns
    if transport.startswith("bifrost"):
        with bifrost.Node("receiver") as node:
            queue = 1000 if transport.endswith("queue") else None
            subscriber = node.subscriber("benchmark", type(MESSAGES[message]), queue=queue)
            while subscriber.receive(timeout=5.0) is None:
                pass
            cpu = time.process_time()
            while (received := subscriber.receive(timeout=1.0)) is not None:
                latencies.append(now() - received.stamp)
            cpu = time.process_time() - cpu
    elif transport == "idle":
        print("ready", flush=True)
        cpu = _paced(lambda: None, count / 4, count)
    else:
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        socket = context.socket(zmq.SUB)
        if transport == "pyzmq CURVE":
            server, public, secret = (key.encode() for key in os.environ["BENCHMARK_KEYS"].split())
            socket.curve_serverkey, socket.curve_publickey, socket.curve_secretkey = server, public, secret
        socket.setsockopt(zmq.SUBSCRIBE, b"")
        socket.connect(endpoint)
        socket.recv()
        socket.setsockopt(zmq.RCVTIMEO, 1000)
        cpu = time.process_time()
        while True:
            try:
                frame = socket.recv()
            except zmq.Again:
                break
            latencies.append(now() - STAMP.unpack_from(frame)[0])
        cpu = time.process_time() - cpu
        context.destroy(linger=0)
    print(json.dumps({"latencies": latencies, "cpu": cpu}))


def measure(transport: str, message: str, rate: float, count: int, environment: dict[str, str]) -> list[str]:
    """One row of the table."""
    payload = bifrost.codec(type(MESSAGES[message])).encode(MESSAGES[message])
    closers: list[Callable[[], None]] = []
    endpoint = "-"
    publish: Callable[[], object]
    if transport.startswith("bifrost"):
        node = bifrost.Node("sender")
        closers.append(node.close)
        publisher, sample = node.publisher("benchmark", type(MESSAGES[message])), MESSAGES[message]
        publish = lambda: publisher.publish(sample)  # noqa: E731
    elif transport == "idle":
        publish = lambda: None  # noqa: E731
    else:
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        closers.append(lambda: context.destroy(linger=0))
        socket = context.socket(zmq.PUB)
        if transport == "pyzmq CURVE":
            public, secret = zmq.curve_keypair()
            socket.curve_secretkey, socket.curve_server = secret, True
            client = [key.decode() for key in zmq.curve_keypair()]
            environment = environment | {"BENCHMARK_KEYS": " ".join((public.decode(), *client))}
        socket.bind("tcp://127.0.0.1:*")
        endpoint = socket.getsockopt_string(zmq.LAST_ENDPOINT)
        publish = lambda: socket.send(STAMP.pack(time.monotonic_ns()) + payload)  # noqa: E731
    command = [sys.executable, __file__, "--receive", transport, message, endpoint, str(count)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, env=environment)
    if transport == "idle":
        assert child.stdout is not None
        child.stdout.readline()
    else:
        _paced(publish, 100.0, 150)  # until the child surely listens
    cpu = _paced(publish, rate, count)
    output, _ = child.communicate()
    for close in closers:
        close()
    result = json.loads(output)
    both = (cpu + result["cpu"]) / count * 1e6
    if transport == "idle":
        return [transport, "-", "-", "-", "-", "-", f"{both:.0f}", "-"]
    latencies = np.array(result["latencies"][-count:]) / 1e3
    quantiles = [f"{np.quantile(latencies, q):.0f}" for q in (0.5, 0.95, 0.99, 1.0)]
    return [transport, message, *quantiles, f"{both:.0f}", f"{max(0, count - len(latencies))}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=float, default=500.0, help="messages a second")
    parser.add_argument("--seconds", type=float, default=4.0, help="a row")
    parser.add_argument("--receive", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.receive:
        transport, message, endpoint, text = options.receive
        receive(transport, message, endpoint, int(text))
        return
    count = int(options.rate * options.seconds)
    with tempfile.TemporaryDirectory() as folder:
        network, keys = Path(folder) / "network.json", Path(folder) / "keys"
        bifrost.Network.create(network, keys)
        os.environ["BIFROST_NETWORK"], os.environ["BIFROST_KEYS"] = str(network), str(keys)
        daemon = subprocess.Popen([sys.executable, "-m", "bifrost.daemon"], stderr=subprocess.DEVNULL)
        try:
            print(f"{options.rate:g} messages a second, {count} a row; latencies and CPU in µs")
            print(ROW.format("transport", "message", "median", "95 %", "99 %", "max", "CPU/message", "lost"))
            for message in MESSAGES:
                for transport in TRANSPORTS[:-1]:
                    print(ROW.format(*measure(transport, message, options.rate, count, dict(os.environ))), flush=True)
            print(ROW.format(*measure("idle", "8 B", options.rate, count, dict(os.environ))))
        finally:
            daemon.terminate()
            daemon.wait()


if __name__ == "__main__":
    main()
