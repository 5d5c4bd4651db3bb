"""The Comms Manager's main loop: Proprioceptor out, Motor in, one control period after another (thesis 3.4.3)."""

from __future__ import annotations

import time
from collections import deque

import bifrost
from valor.common.messages import BehaviorReply, BehaviorRequest, ClockStatus, Proprioceptor
from valor.common.topics import CLOCK, MOTOR, PROPRIOCEPTOR, STOP
from valor.common.trace import Stage
from valor.comms_manager.backend import Backend
from valor.comms_manager.commands import AT_ONCE, Commands
from valor.comms_manager.latch import BehaviorLatch
from valor.comms_manager.leader import Leader
from valor.service import Context, quiet_collector
from valor.whole_body.reflex import BalanceReflex

STAND_BY_PERIOD = 0.05  # between copies of the first Proprioceptor, until a Motor answers it [s]
PAUSED_PERIOD = 0.01  # between looks at requests while robot time stands [s]
STOPS_AT_ONCE = 2  # requests that a period answers, at most


class CommsManager:
    """Runs a backend: measures, publishes, and lets the devices obey what the Motion Manager answers."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._statistics = context.statistics
        self._trace = context.trace
        node = context.node
        self._proprioceptor = PROPRIOCEPTOR.publisher(node)
        self._latch = BehaviorLatch(context.instance.behavior_file, context.settings.epoch)
        motors = MOTOR.subscriber(node, queue=AT_ONCE)
        self._leader = Leader(BalanceReflex(context.robot), self._latch)
        self._stop = STOP.server(node, self._stop_robot)
        self._statistics.watch((motors, self._stop))
        self._commands = Commands(motors, context.robot, self._leader)
        self._clock = ClockReport(CLOCK.publisher(node))
        self._backend = make_backend(context)
        self._time = 0  # robot time [ns]
        self._statistics.depend({MOTOR: motors}, lambda: self._time)
        # Microseconds since the computer started, by a clock that nobody sets: greater than every sequence of earlier
        # runs, so that a Motor which answers the world before a restart is known.
        self._sequence = time.monotonic_ns() // 1000

    def run(self) -> None:
        """Stand by until the first Motor if the backend does, then run until told to stop."""
        quiet_collector()
        if self._backend.waits_for_motor:
            self._stand_by()
        else:
            self._statistics.state("ready")
        backend, commands, statistics, trace = self._backend, self._commands, self._statistics, self._trace
        told = ""
        began = time.perf_counter()
        while not self._context.stopping.is_set():
            waited = backend.advance(commands)
            state = self._measure()
            trace.mark(Stage.MEASURE)
            backend.attend()
            self._stop.serve(STOPS_AT_ONCE)
            self._clock.update(backend, commands, state.time)
            statistics.rejected, statistics.drops = commands.refused, commands.drops
            if (remark := backend.remark) != told:
                told = remark
                statistics.state("ready", remark)
            statistics.cycle(began, waited)
            trace.cycle()
            trace.mark(Stage.ATTEND)
            backend.pace()
            if backend.paused:
                self._stand_still(state)
            began = time.perf_counter()
            self._publish(state)
            trace.mark(Stage.PUBLISH, state.sequence)

    def close(self) -> None:
        """Give back the devices."""
        self._backend.close()
        self._latch.close()

    def _stand_by(self) -> None:
        """Publish one state until a Motor answers it: nothing moves before the controllers are up."""
        state = self._measure()
        while not self._context.stopping.is_set():
            self._publish(state)
            self._statistics.state("ready", "robot time begins with the first Motor")
            self._backend.attend()
            self._stop.serve(STOPS_AT_ONCE)
            self._clock.update(self._backend, self._commands, state.time)
            if self._commands.wait(STAND_BY_PERIOD) or self._leader.abandoned:
                self._statistics.state("ready")
                return
            self._statistics.rejected = self._commands.refused
            self._statistics.idle()

    def _stand_still(self, state: Proprioceptor) -> None:
        """Answer requests until robot time passes again."""
        while self._backend.paused and not self._context.stopping.wait(PAUSED_PERIOD):
            self._backend.attend()
            self._stop.serve(STOPS_AT_ONCE)
            self._clock.update(self._backend, self._commands, state.time)
            self._statistics.state("ready", self._backend.remark)
            self._statistics.idle()
        self._statistics.state("ready", self._backend.remark)

    def _stop_robot(self, request: BehaviorRequest, origin: str) -> BehaviorReply:
        """A robot whose time stands cannot come to rest: time passes for that."""
        self._backend.resume()
        return self._leader.stop(request, origin)

    def _measure(self) -> Proprioceptor:
        self._sequence += 1
        state = self._backend.measure(self._sequence)
        state.motor_behavior = self._leader.behavior
        self._time = state.time
        return state

    def _publish(self, state: Proprioceptor) -> None:
        self._proprioceptor.publish(state)
        self._commands.measured(state, self._backend.demand)


def make_backend(context: Context) -> Backend:
    """The backend of the instance's variant; the other one's libraries are not even imported."""
    if context.settings.variant == "hardware":
        from valor.comms_manager.hardware.backend import Hardware

        return Hardware(context)
    from valor.comms_manager.simulation.backend import Simulation

    return Simulation(context)


class ClockReport:
    """Publishes ClockStatus ten times a second of wall time."""

    PERIOD = 0.1  # [s]

    def __init__(self, publisher: bifrost.Publisher[ClockStatus]) -> None:
        self._publisher = publisher
        self._samples: deque[tuple[float, int]] = deque(maxlen=11)  # wall [s], robot [ns]; a second of them
        self._due = 0.0

    def update(self, backend: Backend, commands: Commands, robot_time: int) -> None:
        """Publish if it is due."""
        now = time.perf_counter()
        if now < self._due:
            return
        self._due = now + self.PERIOD
        self._samples.append((now, robot_time))
        wall_before, robot_before = self._samples[0]
        elapsed = now - wall_before
        self._publisher.publish(
            ClockStatus(
                mode=backend.clock,
                time=robot_time,
                real_time_factor=(robot_time - robot_before) * 1e-9 / elapsed if elapsed > 0 else 0.0,
                slip=backend.slip,
                waits_timed_out=commands.waits_timed_out,
                holding=commands.leader.silent,
            )
        )
