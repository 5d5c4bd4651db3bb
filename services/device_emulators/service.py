"""The test bench's loop: the plant steps on the wall's schedule; what comes over a port is answered at once."""

from __future__ import annotations

import logging
import selectors
import time

from valor.common.pacing import Wall
from valor.common.priority import take_real_time
from valor.common.processes import BY_NAME
from valor.common.topics import GROUND_TRUTH
from valor.device_emulators.bench import FaultServer
from valor.device_emulators.emulator import Emulator
from valor.device_emulators.kinds import make
from valor.device_emulators.robot import SimulatedRobot
from valor.service import Context, quiet_collector
from valor.simulation.push import PushServer
from valor.simulation.truth import Truth

TURN = 0.002  # that the plant stays behind the wall at most, when nobody looks at it or moves it [s]
TELL_EVERY = 1.0  # how commands come, and what the wall has cost [s]
_log = logging.getLogger("device_emulators")


class DeviceEmulators:
    """One simulated robot, and its devices' far ends."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._statistics = context.statistics
        self._robot = SimulatedRobot(context.robot, context.settings)
        self._emulators: list[Emulator] = []
        context.instance.ports.mkdir(exist_ok=True)
        for name in context.robot.tables.devices:
            self._emulators.append(make(name, context.instance, context.settings, context.robot))
        self._truth = Truth(context.robot, self._robot.plant, GROUND_TRUTH.publisher(context.node))
        self._push = PushServer(context.node, self._robot.plant)
        self._faults = FaultServer(context.node, self._emulators)
        self._started = time.monotonic_ns() - context.settings.epoch  # in robot time [ns]
        self._tell_at = 0.0

    def run(self) -> None:
        """Serve the ports and let the plant pass, until told to stop."""
        quiet_collector()
        Wall()  # this thread wakes on time
        take_real_time(BY_NAME[self._context.name].real_time)  # hardware waits for nobody
        robot, statistics, stopping = self._robot, self._statistics, self._context.stopping
        attend_every = max(1, round(1.0 / (Truth.RATE * TURN)))
        with selectors.DefaultSelector() as ports:
            for emulator in self._emulators:
                for file in emulator.files():
                    ports.register(file, selectors.EVENT_READ, emulator)
            statistics.state("ready")
            turns, due = 0, time.monotonic()
            while not stopping.is_set():
                self._serve(ports, due)
                began, now = time.perf_counter(), time.monotonic()
                due = max(due + TURN, now)
                robot.pass_until(now)
                for emulator in self._emulators:
                    emulator.step(now, robot)
                turns += 1
                if turns % attend_every == 0:
                    self._attend(now)
                statistics.cycle(began)
        _log.info("%s", self._report())

    def _serve(self, ports: selectors.BaseSelector, due: float) -> None:
        """Until the next turn is due, answer what comes, each time with the plant as it is by then."""
        while (remaining := due - time.monotonic()) > 0.0:
            if ready := ports.select(remaining):
                now = time.monotonic()
                self._robot.pass_until(now)
                for key, _ in ready:
                    emulator: Emulator = key.data
                    emulator.step(now, self._robot)

    def _attend(self, now: float) -> None:
        """What is due a hundred times a second: the truth, requests, and what the wall has cost."""
        robot_time = self._started + round(1e9 * self._robot.time)
        self._truth.publish(robot_time)
        self._push.serve(robot_time if self._robot.released else 0)
        self._faults.serve(now)
        if now >= self._tell_at:
            self._tell_at = now + TELL_EVERY
            self._statistics.state("ready", self._report())

    def _report(self) -> str:
        return f"{self._robot.slip:.1f} s lost against the wall; {self._robot.commands.describe()}"

    def close(self) -> None:
        """Close the ports."""
        for emulator in self._emulators:
            emulator.close()
