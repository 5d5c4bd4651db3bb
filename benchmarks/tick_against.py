"""The controller's tick against another checkout's: both in turn, tick by tick, on the same Proprioceptors.

A simulated robot stands, is pushed, and walks, led by this checkout's controller. Every Proprioceptor of it goes to two
more processes in turn, one with this checkout's controller and one with the other's. Prints for each part of the run
the median times of their ticks (estimator, fall detection and controller), the ratio of these, and the largest
difference of what the two put out.

    .venv/bin/python benchmarks/tick_against.py OTHER_CHECKOUT [--robot escher] [--profile hardware] [--seconds 8]
"""

from __future__ import annotations

import argparse
import gc
import os
import pickle
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the services run; NumPy reads it once
sys.path.insert(0, str(Path(__file__).parents[1]))  # before the installed one

import numpy as np

from harness.closed_loop import ClosedLoop, load_robot
from valor.common.messages import Proprioceptor
from valor.whole_body.walking.velocity_steps import VelocitySteps

PARTS = {"stands": 0.0, "is pushed": 0.0, "walks": 0.4}  # part of the run → speed [m/s]
PUSH, LASTS = (15.0, 5.0, 0.0), 0.1  # [N·s], [s]
OUTPUTS = ("effort", "acceleration", "position", "velocity", "dcm_reference_in_odom", "desired_foot_forces")
ESTIMATES = ("pelvis_position_in_odom", "pelvis_orientation_in_odom", "dcm_in_odom")


def main() -> None:
    """Lead, or answer the one who does."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, help="a checkout with this file; its Python environment is this one's")
    parser.add_argument("--robot", default="escher")
    parser.add_argument("--profile", default="hardware")
    parser.add_argument("--seconds", type=float, default=8.0, help="of each part")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        serve(Ticker(options.robot, options.profile), sys.stdin.buffer, sys.stdout.buffer)
        return
    serving = ["--serve", "--robot", options.robot, "--profile", options.profile, "."]
    with ExitStack() as stack:
        peers = [
            stack.enter_context(
                subprocess.Popen(
                    [sys.executable, str(checkout.resolve() / "benchmarks" / Path(__file__).name), *serving],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                )
            )
            for checkout in (Path(__file__).parents[1], options.other)
        ]
        compare(Ticker(options.robot, options.profile), peers, options.seconds)


class Ticker:
    """One controller in a closed loop, whose sensors may be somebody else's."""

    def __init__(self, robot: str, profile: str) -> None:
        self.loop = ClosedLoop(load_robot(robot), profile)
        self.loop.settle(0.3)
        self.source = VelocitySteps(self.loop.robot.tables.walking)

    def tick(self, speed: float) -> tuple[float, dict[str, Any]]:
        """One period: how long it took [s], and what was put out."""
        loop = self.loop
        if speed and loop.controller.step_source is None:
            loop.controller.step_source = self.source
        self.source.command(np.array((speed, 0.0, 0.0)), loop.time)
        self.source.advance(loop.time)
        loop.step()
        told = {name: getattr(loop.command, name) for name in OUTPUTS}
        return loop.tick_times[-1], told | {name: getattr(loop.state, name) for name in ESTIMATES}


def serve(ticker: Ticker, requests: BinaryIO, replies: BinaryIO) -> None:
    """Answer each Proprioceptor with a tick; the plant is left alone."""
    fields: list[Any] = []
    ticker.loop.sensors.measure = lambda *_: Proprioceptor(*fields)  # type: ignore[method-assign]
    ticker.loop.plant.step = lambda *_: None  # type: ignore[method-assign]
    gc.freeze()
    gc.disable()
    while True:
        try:
            speed, fields[:] = pickle.load(requests)
        except EOFError:
            return
        pickle.dump(ticker.tick(speed), replies)
        replies.flush()


def asked(peer: subprocess.Popen[bytes], speed: float, given: list[Any]) -> tuple[float, dict[str, Any]]:
    """The tick of a peer on a Proprioceptor's fields."""
    assert peer.stdin is not None
    assert peer.stdout is not None
    pickle.dump((speed, given), peer.stdin)
    peer.stdin.flush()
    answer: tuple[float, dict[str, Any]] = pickle.load(peer.stdout)
    return answer


def compare(ticker: Ticker, peers: list[subprocess.Popen[bytes]], seconds: float) -> None:
    """Lead the robot, ask both peers in turn, and print a table."""
    loop = ticker.loop
    measure = loop.sensors.measure
    given: list[Any] = []

    def watched(*arguments: Any) -> Proprioceptor:
        measured = measure(*arguments)
        given[:] = [getattr(measured, name) for name in measured.__struct_fields__]
        return measured

    loop.sensors.measure = watched  # type: ignore[method-assign, assignment]
    print("| part | this, p50 [µs] | other, p50 [µs] | this / other | largest difference of |")
    print("|---|---|---|---|---|")
    for part, speed in PARTS.items():
        if part == "is pushed":
            loop.plant.push(np.array(PUSH), LASTS)
        times: list[tuple[float, float]] = []
        differences = dict.fromkeys((*OUTPUTS, *ESTIMATES), 0.0)
        for period in range(round(seconds / loop.robot.control_period)):
            ticker.tick(speed)
            order = (0, 1) if period % 2 else (1, 0)
            answers = {i: asked(peers[i], speed, given) for i in order}
            (took, mine), (other_took, others) = answers[0], answers[1]
            times.append((took, other_took))
            for name, value in mine.items():
                difference = float(np.abs(np.nan_to_num(value) - np.nan_to_num(others[name])).max())
                differences[name] = max(differences[name], difference)
        this, other = np.median(times, axis=0) * 1e6
        worst = max(differences, key=lambda name: differences[name])
        told = f"{worst}: {differences[worst]:.1e}" if differences[worst] else "nothing, bit by bit"
        print(f"| {part} | {this:.0f} | {other:.0f} | {this / other:.3f} | {told} |", flush=True)
    if loop.fall:
        print(f"It fell: {loop.fall}")


if __name__ == "__main__":
    main()
