"""The simulated devices behind the main loop."""

from __future__ import annotations

from valor.common.errors import ConfigurationError
from valor.common.messages import Proprioceptor
from valor.common.pacing import Pacer, Wall
from valor.common.topics import CYCLE, GROUND_TRUTH, PAUSED
from valor.comms_manager.backend import Backend
from valor.comms_manager.commands import Commands
from valor.comms_manager.simulation.clock import BACKLOG, CLOCKS, HASTE
from valor.comms_manager.simulation.in_step import InStep
from valor.comms_manager.simulation.tempo import Tempo
from valor.service import Context
from valor.simulation.plant import Plant
from valor.simulation.push import PushServer
from valor.simulation.sensors import Sensors
from valor.simulation.truth import Truth


class Simulation(Backend):
    """MuJoCo in process: a plant, its sensors, and a clock that says when it steps."""

    def __init__(self, context: Context) -> None:
        settings, robot = context.settings, context.robot
        plant = Plant(robot, settings.world, settings.actuators, settings.seed)
        if not settings.real_time_factor >= 0.0:
            raise ConfigurationError(f"real_time_factor {settings.real_time_factor:g}: expected 0 or more")
        rate = settings.real_time_factor if settings.clock == "lockstep" else 1.0
        self._pacer = Pacer(rate, Wall(), BACKLOG, HASTE)
        waits = settings.wait_for_vrc and settings.clock == "lockstep"
        self._in_step = InStep(CYCLE.subscriber(context.node)) if waits else None
        self._clock = CLOCKS[settings.clock](plant, robot.physics_steps(), self._pacer, context.trace, self._in_step)
        self._sensors = Sensors(robot, plant, robot.tables.actuators[settings.actuators].noise, settings.seed)
        self._truth = Truth(robot, plant, GROUND_TRUTH.publisher(context.node))
        self._truth_every = max(1, round(robot.tables.control_rate / Truth.RATE))
        self._push_server = PushServer(context.node, plant)
        self._tempo = Tempo(context.node, self._pacer, rate)
        self._period = round(robot.control_period * 1e9)
        self._periods = 0

    @property
    def clock(self) -> str:
        """``lockstep`` or ``realtime``; ``paused``."""
        return PAUSED if self.paused else self._clock.name

    @property
    def paused(self) -> bool:
        """Whether robot time stands."""
        return self._tempo.paused

    def resume(self) -> None:
        """Let robot time pass."""
        self._tempo.resume()

    @property
    def slip(self) -> float:
        """Robot time lost against the wall since the first Motor [s]."""
        return self._pacer.slip

    @property
    def remark(self) -> str:
        """Who is no longer waited for in lockstep; that time stands."""
        if self.paused:
            return "robot time is paused"
        return self._in_step.remark if self._in_step else ""

    def advance(self, commands: Commands) -> float:
        """Step the plant to the end of the control period; returns the time spent waiting [s]."""
        waited = self._clock.advance(commands)
        self._periods += 1
        self._tempo.passed()
        return waited

    def measure(self, sequence: int) -> Proprioceptor:
        """The state of all devices at the end of the period."""
        return self._sensors.measure(sequence, self._time)

    def attend(self) -> None:
        """Answer requests; publish the truth when it is due."""
        if self.paused:
            self._serve()
        elif self._periods % self._truth_every == 0:
            self._truth.publish(self._time)
            self._serve()

    def _serve(self) -> None:
        self._push_server.serve(self._time)
        self._tempo.serve(self._time)

    def pace(self) -> None:
        """Sleep until the end of the period is due."""
        self._clock.pace()

    def close(self) -> None:
        """Nothing to give back: the node closes its sockets, MuJoCo's memory goes with the process."""

    @property
    def _time(self) -> int:
        """Robot time [ns]."""
        return self._periods * self._period
