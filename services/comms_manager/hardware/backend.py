"""The real devices behind the main loop: find them, switch them on, and exchange states and commands every period.

::

    period     |<------------------------ control period ------------------------>|
    main loop  SYNC → gather → Proprioceptor ── wait for Motor ──→ hand out, sleep → SYNC …
    devices       their threads, at their own rates
"""

from __future__ import annotations

import logging
import sys
import threading
import time

import numpy as np

from valor.common.errors import ConfigurationError
from valor.common.messages import Motor, Proprioceptor
from valor.common.pacing import Pacer, Wall
from valor.common.priority import take_real_time
from valor.common.processes import BY_NAME
from valor.common.topics import DEVICES
from valor.common.trace import Stage
from valor.comms_manager.backend import Backend
from valor.comms_manager.commands import Commands
from valor.comms_manager.hardware.device import (
    Ailment,
    Device,
    DeviceContext,
    DeviceError,
    Fault,
    JointCommands,
    providers,
)
from valor.comms_manager.hardware.holding import holding
from valor.comms_manager.hardware.kinds import make
from valor.comms_manager.hardware.proprioception import Proprioception, require_complete
from valor.comms_manager.hardware.robot_time import RobotTime
from valor.comms_manager.hardware.watch import DeviceWatch
from valor.devices.kinds import Quantity
from valor.service import Context

LONGEST_WAIT = 1.0  # for the devices' clock [s]
# Five threads share the interpreter: whoever waits for it is to wait less than the five milliseconds of the default.
_SWITCH_INTERVAL = 0.0005
_log = logging.getLogger("comms_manager")


class Hardware(Backend):
    """All devices of robot.yaml."""

    waits_for_motor = False  # the robot's time passes by itself

    def __init__(self, context: Context) -> None:
        self._context, robot = context, context.robot
        self._robot = robot
        self._devices: list[Device] = []
        self._threads: list[threading.Thread] = []
        self._stopping = threading.Event()
        device_context = DeviceContext(context.instance, context.settings, robot)
        try:
            for name in robot.tables.devices:
                self._devices.append(make(name, device_context))
            require_complete(robot, self._devices)
            self._start()
        except DeviceError as error:
            self.close()
            raise ConfigurationError(str(error)) from None
        except BaseException:
            self.close()
            raise
        self._moving = providers(self._devices, Quantity.JOINT_STATE)
        self._senses = Proprioception(robot, self._devices)
        self._watch = DeviceWatch(self._devices)
        self._status = DEVICES.publisher(context.node)
        self._pacer = Pacer(1.0, Wall())
        self._admitted = 0
        self._motor_sequence = 0
        self._held: Motor | None = None  # while nobody leads the joints
        for _ in range(2):  # the time by the devices' clock begins with that
            self._sample()
        clock = next(iter(providers(self._devices, Quantity.TIME)), None)
        now = time.monotonic_ns() - context.settings.epoch
        self._time = RobotTime((lambda: clock.elapsed) if clock else None, robot.control_period, now)

    def _start(self) -> None:
        for device in self._devices:
            self._context.statistics.state("starting", f"finding {device.name}")
            device.find()
            _log.info("%s: found, %d units", device.name, len(device.records))
        for device in self._devices:
            self._context.statistics.state("starting", f"switching on {device.name}")
            device.enable()
        sys.setswitchinterval(_SWITCH_INTERVAL)
        for device in self._devices:
            thread = threading.Thread(target=self._run, args=(device,), name=device.name, daemon=True)
            thread.start()
            self._threads.append(thread)
        if take_real_time(BY_NAME[self._context.name].real_time):
            _log.info("the loop and its devices run in real time")

    def _sample(self) -> None:
        for device in self._devices:
            device.request_states()
        for device in self._devices:
            device.await_states()

    def _run(self, device: Device) -> None:
        """A device's thread; one that ends too early is told of here, for all of its units."""
        Wall()  # the thread wakes on time
        try:
            device.run(self._stopping)
        except Exception as error:
            _log.exception("%s: its thread ended", device.name)
            text = f"nobody speaks to it: {type(error).__name__}, see the log; the Comms Manager is to be restarted"
            device.tell([Ailment(record.unit, Fault.FAULTY, text) for record in device.records])

    @property
    def clock(self) -> str:
        """``hardware``."""
        return "hardware"

    @property
    def slip(self) -> float:
        """By how much less robot time than time on the wall has passed since start [s]."""
        return max(0.0, 1e-9 * (time.monotonic_ns() - self._context.settings.epoch - self._time.now))

    def advance(self, commands: Commands) -> float:
        """Hand out the Motor that comes, wait for the end of the period, and have the devices sample."""
        began = time.perf_counter()
        self._wait(commands, self._pacer.next(self._robot.control_period))
        self._pass_time(commands)
        self._context.trace.mark(Stage.DEVICES)
        return time.perf_counter() - began

    def _wait(self, commands: Commands, duration: float) -> None:
        """Wait [s], and hand out the Motor that comes meanwhile."""
        due = time.perf_counter() + duration
        remaining = duration
        while True:
            # Each as it comes, and not the newest alone: one that comes after its period is late enough already.
            if not commands.answered:
                commands.listen(remaining)
            self._hand_out(commands)
            remaining = due - time.perf_counter()
            if remaining <= 0.0:
                return
            if commands.answered:
                time.sleep(remaining)
                return

    def _pass_time(self, commands: Commands) -> None:
        """Have the devices sample, until by their clock a period has passed since they were heard last.

        A bus on which nobody speaks is waited for once: its controllers' watchdogs hold the joints meanwhile.
        """
        clock, began = self._time, time.monotonic()
        self._sample()
        while (lacking := clock.lacking) and not clock.is_lost and time.monotonic() - began <= LONGEST_WAIT:
            self._wait(commands, lacking)
            self._sample()
        clock.pass_period(lost=lacking > 0.0)

    def _hand_out(self, commands: Commands) -> None:
        leader = commands.leader
        if leader.silent and leader.limp and leader.motor is not None:
            self._held = None
            self._send(leader.motor)  # again and again: the motor controllers would hold a joint that hears nothing
        elif leader.silent and leader.motor is not None:
            if self._held is None:
                self._held = holding(leader.motor, self._senses.position, self._senses.effort)
            self._send(self._held)
        elif leader.admitted != self._admitted and leader.motor is not None:
            self._held = None
            self._send(leader.motor)
        self._admitted = leader.admitted

    def _send(self, motor: Motor) -> None:
        """Hand a sound Motor to the devices; the last place where set-points are brought within limits."""
        robot = self._robot
        position = np.minimum(np.maximum(motor.position, robot.lower), robot.upper)
        effort = np.minimum(np.maximum(motor.effort, -robot.effort_limit), robot.effort_limit)
        self._motor_sequence = motor.sequence
        for device in self._moving:
            places = device.joints
            device.send(
                JointCommands(
                    motor.sequence,
                    motor.mode[places],
                    position[places],
                    motor.velocity[places],
                    effort[places],
                    motor.stiffness[places],
                    motor.damping[places],
                )
            )

    def measure(self, sequence: int) -> Proprioceptor:
        """The newest states of all devices; those of a silent unit are its last."""
        return self._senses.measure(self._time.now, sequence, self._motor_sequence, self._watch.leader)

    def attend(self) -> None:
        """Watch the devices; report them when something changes, and every second."""
        leader = self._watch.leader
        if self._watch.update(self._time.now):
            self.demand = self._watch.reaction
            self._status.publish(self._watch.report(self._time.now))
            self._senses.look_at_supply()
        if self._watch.leader is not leader and self._watch.leader is not None:
            self._context.statistics.state("ready", f"the attitude is that of {self._watch.leader.name}")

    def pace(self) -> None:
        """Nothing: the period ended before its states were taken."""

    def close(self) -> None:
        """End the threads; the motor controllers' watchdogs hold the joints."""
        self._stopping.set()
        for device in self._devices:
            device.wake()
        for thread in self._threads:
            thread.join(timeout=1.0)
        for device in self._devices:
            device.close()
