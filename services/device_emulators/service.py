"""The test bench's loop: the plant steps on the wall's schedule; what comes over a port is answered at once."""

from __future__ import annotations

import logging
import selectors
import time

from device_emulators.bench import FaultServer
from device_emulators.emulator import Emulator
from device_emulators.kinds import make
from device_emulators.robot import SimulatedRobot
from valor_common.messages import GroundTruth
from valor_common.pacing import Pacer, Wall
from valor_common.service import Context, quiet_collector
from valor_common.topics import GROUND_TRUTH
from valor_simulation.push import PushServer
from valor_simulation.truth import Truth

STEPS = 1  # of physics at once
_SLIP_TOLD = 0.1  # lost against the wall, each time by so much more it is told [s]
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
        self._truth = Truth(context.robot, self._robot.plant, context.node.publisher(GROUND_TRUTH.name, GroundTruth))
        self._push = PushServer(context.node, self._robot.plant)
        self._faults = FaultServer(context.node, self._emulators)
        self._pacer = Pacer(1.0, Wall())
        self._started = time.monotonic_ns() - context.settings.epoch  # in robot time [ns]
        self._waited = 0.0  # stood still, since commands were late [s]
        self._slip_told = 0.0

    def run(self) -> None:
        """Serve the ports and let the plant pass, until told to stop."""
        quiet_collector()
        robot, statistics, pacer = self._robot, self._statistics, self._pacer
        duration = STEPS * robot.plant.step_time
        attend_every = max(1, round(1.0 / (Truth.RATE * duration)))
        with selectors.DefaultSelector() as ports:
            for emulator in self._emulators:
                for file in emulator.files():
                    ports.register(file, selectors.EVENT_READ, emulator)
            statistics.state("ready")
            turns = 0
            while not self._context.stopping.is_set():
                self._serve(ports, duration)
                began = time.perf_counter()
                if robot.waits:
                    self._waited += duration
                else:
                    robot.advance(STEPS)
                now = time.monotonic()
                for emulator in self._emulators:
                    emulator.step(now, robot)
                turns += 1
                if turns % attend_every == 0:
                    self._attend(now)
                statistics.cycle(began)
        _log.info(
            "%.3f s lost against the wall, %.3f s of it waiting for commands", pacer.slip + self._waited, self._waited
        )

    def _serve(self, ports: selectors.BaseSelector, duration: float) -> None:
        """Answer what comes until the next step of the plant is due."""
        remaining = self._pacer.next(duration)
        while remaining > 0.0:
            for key, _ in ports.select(remaining):
                emulator: Emulator = key.data
                emulator.step(time.monotonic(), self._robot)
            remaining = self._pacer.remaining()

    def _attend(self, now: float) -> None:
        """What is due a hundred times a second: the truth, requests, and what the wall has cost."""
        robot_time = self._started + round(1e9 * self._robot.time)
        self._truth.publish(robot_time)
        self._push.serve(robot_time if self._robot.released else 0)
        self._faults.serve(now)
        slip = self._pacer.slip + self._waited
        if slip - self._slip_told > _SLIP_TOLD:
            self._slip_told = slip
            self._statistics.state("ready", f"{slip:.1f} s lost against the wall")

    def close(self) -> None:
        """Close the ports."""
        for emulator in self._emulators:
            emulator.close()
