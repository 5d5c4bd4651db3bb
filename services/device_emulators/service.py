"""Process of the emulated devices: steps the plant by the wall clock, and responds to received data at once."""

import logging
import math
import selectors
import time
from collections.abc import Sequence

import bifrost
from valor.common.messages import FaultReply, FaultRequest
from valor.common.pacing import WallClock
from valor.common.priority import take_real_time
from valor.common.processes import BY_NAME
from valor.common.topics import FAULT, GROUND_TRUTH
from valor.device_emulators.emulator import LONGEST_REST, EmulatedFault, Emulator, NoSuchFaultError, make_emulator
from valor.device_emulators.robot import SimulatedRobot
from valor.service import Context, quiet_collector
from valor.simulation.plant import PushServer, Truth

TURN = 0.002  # longest time between steps of the plant [s]
REPORT_PERIOD = 1.0  # between reports of command intervals and slip [s]
MAX_DURATION = 3600.0  # of a fault [s]
_log = logging.getLogger("device_emulators")


class FaultServer:
    """Server of ``simulation/fault``: starts a fault of a unit, or ends all faults of a device."""

    def __init__(self, node: bifrost.Node, emulators: Sequence[Emulator]) -> None:
        self._emulators = {emulator.name: emulator for emulator in emulators}
        self._server = FAULT.server(node, self._inject)
        self._now = 0.0

    def serve(self, now: float) -> None:
        self._now = now
        self._server.serve()

    def _inject(self, request: FaultRequest, origin: str) -> FaultReply:
        reason = self._apply(request)
        if not reason:
            what = request.fault or "no fault"
            _log.info("%s requested %s of %s/%s for %g s", origin, what, request.device, request.unit, request.duration)
        return FaultReply(accepted=not reason, reason=reason)

    def _apply(self, request: FaultRequest) -> str:
        """Apply a request; returns the reason of a rejection, empty if accepted."""
        emulator = self._emulators.get(request.device)
        if emulator is None:
            return f"device {request.device!r}: expected one of {', '.join(self._emulators)}"
        if not request.fault:
            emulator.faults.clear()
            return ""
        if not 0.0 <= request.duration <= MAX_DURATION:  # also rejects NaN
            return f"duration: {request.duration:g} s, expected up to {MAX_DURATION:g}, or 0 for no limit"
        try:
            fault = EmulatedFault(request.fault)
        except ValueError:
            expected = ", ".join(sorted(EmulatedFault))
            return f"fault {request.fault!r}: expected one of {expected}; empty to end all faults"
        until = self._now + request.duration if request.duration else math.inf
        try:
            emulator.faults.inject(request.unit, fault, until)
        except NoSuchFaultError as error:
            return str(error)
        return ""


class DeviceEmulators:
    """Service: one simulated robot and the emulators of its devices."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._statistics = context.statistics
        self._robot = SimulatedRobot(context.robot, context.settings)
        self._emulators: list[Emulator] = []
        context.instance.ports.mkdir(exist_ok=True)
        for name in context.robot.tables.devices:
            self._emulators.append(make_emulator(name, context.instance, context.settings, context.robot))
        self._truth = Truth(context.robot, self._robot.plant, GROUND_TRUTH.publisher(context.node))
        self._push = PushServer(context.node, self._robot.plant)
        self._faults = FaultServer(context.node, self._emulators)
        self._started = time.monotonic_ns() - context.settings.epoch  # robot time at start [ns]
        self._report_due = 0.0

    def run(self) -> None:
        """Serve the ports and advance the plant until stopped."""
        quiet_collector()
        WallClock()  # sets the timer slack of this thread
        take_real_time(BY_NAME[self._context.name].real_time)  # hardware does not wait either
        robot, statistics, stopping = self._robot, self._statistics, self._context.stopping
        request_turns = max(1, round(1.0 / (Truth.RATE * TURN)))
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
                self._step([emulator for emulator in self._emulators if now >= emulator.due], now)
                turns += 1
                if turns % request_turns == 0:
                    self._serve_requests(now)
                statistics.cycle(began)
        _log.info("%s", self._report())

    def _serve(self, ports: selectors.BaseSelector, due: float) -> None:
        """Respond to received data until the next turn is due, with the plant advanced to that time."""
        while (remaining := due - time.monotonic()) > 0.0:
            if ready := ports.select(remaining):
                now = time.monotonic()
                self._robot.pass_until(now)
                self._step([key.data for key, _ in ready], now)

    def _step(self, emulators: Sequence[Emulator], now: float) -> None:
        for emulator in emulators:
            emulator.due = now + LONGEST_REST
            emulator.step(now, self._robot)

    def _serve_requests(self, now: float) -> None:
        """Publish the ground truth, process requests and report, at 100 Hz."""
        robot_time = self._started + round(1e9 * self._robot.time)
        self._truth.publish(robot_time)
        self._push.serve(robot_time if self._robot.released else 0)
        self._faults.serve(now)
        if now >= self._report_due:
            self._report_due = now + REPORT_PERIOD
            self._statistics.state("ready", self._report())

    def _report(self) -> str:
        return f"{self._robot.slip:.1f} s slip"

    def close(self) -> None:
        for emulator in self._emulators:
            emulator.close()
