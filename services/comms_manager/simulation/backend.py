"""The simulated devices behind the main loop."""

import math

import bifrost
from valor.common.errors import ConfigurationError
from valor.common.messages import Proprioceptor, TimeReply, TimeRequest
from valor.common.pacing import Pacer, WallClock
from valor.common.processes import LIDAR
from valor.common.topics import CYCLE, DEVICES, GROUND_TRUTH, PAUSED, SIMULATED_TIME
from valor.comms_manager.backend import Backend
from valor.comms_manager.batteries import BatteryMonitor
from valor.comms_manager.commands import Commands
from valor.comms_manager.hardware.watch import DeviceWatch
from valor.comms_manager.simulation.clock import BACKLOG, CLOCKS, HASTE, VrcLockstep
from valor.service import Context
from valor.simulation.plant import Plant, PushServer, Truth
from valor.simulation.sensors import Sensors

AT_ONCE = 4  # largest number of requests per check
LARGEST_FACTOR = 100.0  # of robot time to wall clock
MOST_STEPS = 100_000


class TimeServer:
    """Server of ``simulation/time``."""

    def __init__(self, node: bifrost.Node, pacer: Pacer, factor: float) -> None:
        self._pacer = pacer
        self.factor = factor  # of robot time to wall clock; 0: as fast as possible
        self._halted = False
        self._steps = 0  # periods that pass although time is halted
        self._time = 0
        self._server = SIMULATED_TIME.server(node, self._respond)

    @property
    def paused(self) -> bool:
        return self._halted and self._steps == 0

    def serve(self, time: int) -> None:
        """Process pending requests at a robot time [ns]."""
        self._time = time
        self._server.serve(AT_ONCE)

    def end_period(self) -> None:
        self._steps = max(0, self._steps - 1)

    def resume(self) -> None:
        """Resume robot time, if it is paused."""
        if self._halted:
            self._halted, self._steps = False, 0
            self._pacer.restart(self.factor)

    def _respond(self, request: TimeRequest, origin: str) -> TimeReply:
        reason = self._execute(request.wanted, request.value)
        return TimeReply(not reason, self.paused, self.factor, self._time, reason)

    def _execute(self, verb: str, value: float) -> str:
        """Execute a request; returns the reason of a rejection, or an empty string."""
        if verb == "":
            return ""
        if not self._time:
            return "robot time has not started: no Motor has been received yet"
        if verb == "pause":
            self._halted, self._steps = True, 0
        elif verb == "resume":
            self.resume()
        elif verb == "step":
            if not (1.0 <= value <= MOST_STEPS and value == math.floor(value)):
                return f"step: {value:g} control periods, expected 1 to {MOST_STEPS}"
            self._halted, self._steps = True, int(value)
            self._pacer.restart(self.factor)
        elif verb == "factor":
            if not 0.0 <= value <= LARGEST_FACTOR:
                return f"factor: {value:g}, expected 0 to {LARGEST_FACTOR:g} times the wall clock"
            self.factor = value
            self._pacer.restart(value)
        else:
            return f"wanted: {verb[:64]!r}, expected pause, resume, step or factor"
        return ""


class Simulation(Backend):
    """MuJoCo in process: a plant, its sensors, and a clock that steps it."""

    def __init__(self, context: Context) -> None:
        settings, robot = context.settings, context.robot
        plant = Plant(robot, settings.world, settings.actuators, settings.seed, spins=LIDAR in settings.asked)
        if not settings.real_time_factor >= 0.0:
            raise ConfigurationError(f"real_time_factor {settings.real_time_factor:g}: expected 0 or more")
        rate = settings.real_time_factor if settings.clock == "lockstep" else 1.0
        self._pacer = Pacer(rate, WallClock(), BACKLOG, HASTE)
        waits = settings.wait_for_vrc and settings.clock == "lockstep"
        self._vrc_lockstep = VrcLockstep(CYCLE.subscriber(context.node)) if waits else None
        self._clock = CLOCKS[settings.clock](
            plant, robot.physics_steps(), self._pacer, context.trace, self._vrc_lockstep
        )
        self._sensors = Sensors(robot, plant, robot.tables.actuators[settings.actuators].noise, settings.seed)
        self._truth = Truth(robot, plant, GROUND_TRUTH.publisher(context.node))
        self._truth_every = max(1, round(robot.tables.control_rate / Truth.RATE))
        self._push_server = PushServer(context.node, plant)
        self._time_server = TimeServer(context.node, self._pacer, rate)
        self.batteries = BatteryMonitor.of(context)
        self._watch = DeviceWatch((), self.batteries)
        self._status = DEVICES.publisher(context.node) if self.batteries else None
        self._period = round(robot.control_period * 1e9)
        self._periods = 0

    @property
    def clock(self) -> str:
        return PAUSED if self.paused else self._clock.name

    @property
    def paused(self) -> bool:
        return self._time_server.paused

    def resume(self) -> None:
        self._time_server.resume()

    @property
    def slip(self) -> float:
        return self._pacer.slip

    @property
    def note(self) -> str:
        if self.paused:
            return "robot time is paused"
        return self._vrc_lockstep.note if self._vrc_lockstep else ""

    def advance(self, commands: Commands) -> float:
        waited = self._clock.advance(commands)
        self._periods += 1
        self._time_server.end_period()
        return waited

    def measure(self, sequence: int) -> Proprioceptor:
        return self._sensors.measure(sequence, self._time)

    def attend(self) -> None:
        if self.paused:
            self._serve()
        elif self._periods % self._truth_every == 0:
            self._truth.publish(self._time)
            if self._status and self._watch.update(self._time):
                self.demand = self._watch.reaction
                self._status.publish(self._watch.report(self._time))
            self._serve()

    def _serve(self) -> None:
        self._push_server.serve(self._time)
        self._time_server.serve(self._time)

    def pace(self) -> None:
        self._clock.pace()

    def close(self) -> None:
        """Nothing: the node closes its sockets."""

    @property
    def _time(self) -> int:
        """Robot time [ns]."""
        return self._periods * self._period
