"""The Comms Manager's main loop: Proprioceptor out, Motor in, one control period after another (thesis 3.4.3)."""

import time
from collections import deque

import bifrost
from valor.common.messages import BehaviorReply, BehaviorRequest, ClockStatus, Proprioceptor
from valor.common.topics import CLOCK, MOTOR, PROPRIOCEPTOR, STOP
from valor.common.trace import Stage
from valor.comms_manager.backend import Backend
from valor.comms_manager.command_arbiter import BehaviorLatch, CommandArbiter
from valor.comms_manager.commands import AT_ONCE, Commands
from valor.service import Context, quiet_collector
from valor.whole_body.reflex import BalanceReflex

STAND_BY_PERIOD = 0.05  # period of repeating the first Proprioceptor, until a Motor answers it [s]
PAUSED_PERIOD = 0.01  # period of serving requests while robot time is paused [s]
STOPS_AT_ONCE = 2  # largest number of stop requests per period


class CommsManager:
    """Runs a backend: measures, publishes, and applies the Motion Manager's Motors."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._statistics = context.statistics
        self._trace = context.trace
        node = context.node
        self._proprioceptor = PROPRIOCEPTOR.publisher(node)
        self._latch = BehaviorLatch(context.instance.behavior_file, context.settings.epoch)
        motors = MOTOR.subscriber(node, queue=AT_ONCE)
        self._arbiter = CommandArbiter(BalanceReflex(context.robot), self._latch)
        self._stop = STOP.server(node, self._stop_robot)
        self._statistics.watch((motors, self._stop))
        self._commands = Commands(motors, context.robot, self._arbiter)
        self._clock = ClockReport(CLOCK.publisher(node))
        self._backend = make_backend(context)
        self._time = 0  # robot time [ns]
        self._statistics.depend({MOTOR: motors}, lambda: self._time)
        # Monotonic microseconds exceed every sequence of earlier runs, so that Motors for an earlier run are detected.
        self._sequence = time.monotonic_ns() // 1000

    def run(self) -> None:
        """Wait for the first Motor, if the backend does, then run until the service stops."""
        quiet_collector()
        if self._backend.waits_for_motor:
            self._stand_by()
        else:
            self._statistics.state("ready")
        backend, commands, statistics, trace = self._backend, self._commands, self._statistics, self._trace
        reported = ""
        began = time.perf_counter()
        while not self._context.stopping.is_set():
            waited = backend.advance(commands)
            state = self._measure()
            trace.mark(Stage.MEASURE)
            self._attend(state)
            statistics.rejected, statistics.drops = commands.rejected, commands.drops
            if (note := next(filter(None, (backend.note, *(each.note for each in backend.batteries))), "")) != reported:
                reported = note
                statistics.state("ready", note)
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
        self._backend.close()
        self._latch.close()

    def _stand_by(self) -> None:
        """Repeat one state until a Motor answers it: nothing moves before the controllers are ready."""
        state = self._measure()
        while not self._context.stopping.is_set():
            self._publish(state)
            self._statistics.state("ready", "robot time starts with the first Motor")
            self._attend(state)
            if self._commands.wait(STAND_BY_PERIOD) or self._arbiter.abandoned:
                self._statistics.state("ready")
                return
            self._statistics.rejected = self._commands.rejected
            self._statistics.idle()

    def _stand_still(self, state: Proprioceptor) -> None:
        while self._backend.paused and not self._context.stopping.wait(PAUSED_PERIOD):
            self._attend(state)
            self._statistics.state("ready", self._backend.note)
            self._statistics.idle()
        self._statistics.state("ready", self._backend.note)

    def _attend(self, state: Proprioceptor) -> None:
        self._backend.attend()
        self._stop.serve(STOPS_AT_ONCE)
        self._clock.update(self._backend, self._commands, state.time)

    def _stop_robot(self, request: BehaviorRequest, origin: str) -> BehaviorReply:
        """Resume robot time, without which the robot cannot come to rest, and stop the robot."""
        self._backend.resume()
        return self._arbiter.stop(request, origin)

    def _measure(self) -> Proprioceptor:
        self._sequence += 1
        state = self._backend.measure(self._sequence)
        state.motor_behavior = self._arbiter.behavior
        for batteries in self._backend.batteries:
            batteries.update(state)
        self._time = state.time
        return state

    def _publish(self, state: Proprioceptor) -> None:
        self._proprioceptor.publish(state)
        self._commands.measured(state, self._backend.demand)


def make_backend(context: Context) -> Backend:
    """Backend of the instance's variant; libraries of the other one are not imported."""
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
                holding=commands.arbiter.silent,
            )
        )
