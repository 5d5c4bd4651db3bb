"""Hardware backend: finds the devices, switches them on, and exchanges states and commands every period.

::

    period     |<------------------------ control period ------------------------>|
    main loop  SYNC → gather → Proprioceptor ── wait for Motor ──→ hand out, sleep → SYNC …
"""

import logging
import sys
import threading
import time
from collections.abc import Callable

import numpy as np
from msgspec import structs

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.messages import JointMode, Motor, Proprioceptor
from valor.common.pacing import Pacer, WallClock
from valor.common.priority import take_real_time
from valor.common.processes import BY_NAME
from valor.common.topics import DEVICES
from valor.common.trace import Stage
from valor.comms_manager.backend import Backend
from valor.comms_manager.batteries import BatteryMonitor
from valor.comms_manager.commands import Commands
from valor.comms_manager.hardware.device import (
    Device,
    DeviceContext,
    DeviceError,
    Fault,
    JointCommands,
    UnitFault,
    make_device,
    providers,
)
from valor.comms_manager.hardware.proprioception import Proprioception
from valor.comms_manager.hardware.watch import DeviceWatch
from valor.devices.kinds import Quantity
from valor.service import Context

LONGEST_WAIT = 1.0  # timeout of the devices' clock [s]
# Threads share the interpreter: the main loop must get it in less than the default of 5 ms.
_SWITCH_INTERVAL = 0.0005
_log = logging.getLogger("comms_manager")


# Largest remainder of a period that is not waited for, as a fraction. With less than half, a late loop does not sample
# twice a period permanently; no whole millisecond of 4 or 5 ms, the resolution of an emulator's clock.
REMAINDER = 0.45


class RobotTime:
    """Robot time by the devices' clock."""

    def __init__(self, elapsed: Callable[[], int] | None, period: float, now: int) -> None:
        """``elapsed``: time by the devices' clock [ns], if any; ``period`` [s]; ``now``: robot time [ns]."""
        self._clock, self._period = elapsed, period
        self._elapsed = elapsed() if elapsed else 0
        self.now = now  # of the latest states [ns]
        self.is_lost = False  # the clock has stopped; every period counts as a nominal one

    @property
    def remaining(self) -> float:
        """Rest of the present period by the devices' clock [s]; 0 if it is over."""
        if self._clock is None:
            return 0.0
        remaining = self._period - 1e-9 * (self._clock() - self._elapsed)
        return remaining if remaining >= REMAINDER * self._period else 0.0

    def end_period(self, lost: bool) -> None:
        elapsed = round(1e9 * self._period)
        if self._clock is not None:
            now = self._clock()
            if not lost:
                elapsed = now - self._elapsed
            self._elapsed = now
        self.is_lost = lost
        self.now += elapsed


def holding(last: Motor, position: FloatArray, effort: FloatArray) -> Motor:
    """Motor that holds every joint at rest with its own servo.

    A joint in position mode keeps its set-point, and so its load. All others start from their position with their
    measured effort: without it they would sag until their servos carry as much. For a soft servo, as a finger's, the
    noise of a measured effort would be a motion.

    Args:
        last: the active Motor.
        position: (n,) measured [rad].
        effort: (n,) measured [N·m]; NaN: not measured.
    """
    servo = last.mode == JointMode.POSITION
    zero = np.zeros(position.size)
    return structs.replace(
        last,
        mode=np.full(position.size, JointMode.POSITION, dtype=np.uint8),
        position=np.where(servo, last.position, position),
        velocity=zero,
        effort=np.where(servo, last.effort, np.nan_to_num(effort)),
        stiffness=zero,
        damping=zero,
    )


class Hardware(Backend):
    """All devices of robot.yaml."""

    waits_for_motor = False  # robot time passes independently

    def __init__(self, context: Context) -> None:
        self._context, self._robot, robot = context, context.robot, context.robot
        self._devices: list[Device] = []
        self._threads: list[threading.Thread] = []
        self._ended: set[Device] = set()  # by an error of their driver
        self._stopping = threading.Event()
        device_context = DeviceContext(context.instance, context.settings, robot)
        try:
            for name in robot.tables.devices:
                self._devices.append(make_device(name, device_context))
            robot.require_devices()
            self._start()
        except BaseException as error:
            self.close()
            if isinstance(error, DeviceError):
                raise ConfigurationError(str(error)) from None
            raise
        self._moving = providers(self._devices, Quantity.JOINT_STATE)
        self._senses = Proprioception(robot, self._devices)
        self.batteries = BatteryMonitor.of(context)
        self._watch = DeviceWatch(self._devices, self.batteries)
        self._status = DEVICES.publisher(context.node)
        self._pacer = Pacer(1.0, WallClock())
        self._admitted = 0
        self._motor_sequence = 0
        self._held: Motor | None = None  # without a command source
        for _ in range(2):  # the devices' clock starts with it
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
            self._attempt(device, device.request_states)
        for device in self._devices:
            self._attempt(device, device.gather)

    def _run(self, device: Device) -> None:
        WallClock()  # the thread wakes on time
        self._attempt(device, device.run, self._stopping)

    def _attempt(self, device: Device, work: Callable[..., None], *arguments: object) -> None:
        """Let a device work; an error of its driver ends it, and none of the others."""
        if device in self._ended:
            return
        try:
            work(*arguments)
        except Exception as error:
            self._ended.add(device)
            _log.exception("%s: its driver ended", device.name)
            text = f"its driver has ended: {type(error).__name__}, see the log; restart the Comms Manager"
            device.report_faults([UnitFault(record.unit, Fault.FAULTY, text) for record in device.records])

    @property
    def clock(self) -> str:
        return "hardware"

    @property
    def slip(self) -> float:
        return max(0.0, 1e-9 * (time.monotonic_ns() - self._context.settings.epoch - self._time.now))

    def advance(self, commands: Commands) -> float:
        began = time.perf_counter()
        self._wait(commands, self._pacer.next(self._robot.control_period))
        self._pass_time(commands)
        self._context.trace.mark(Stage.DEVICES)
        return time.perf_counter() - began

    def _wait(self, commands: Commands, duration: float) -> None:
        """Wait [s], and send Motors received during this time."""
        due = time.perf_counter() + duration
        remaining = duration
        while True:
            # Immediately: a Motor that arrives after its period is late already.
            if not commands.answered:
                commands.listen(remaining)
            self._pass_on(commands)
            remaining = due - time.perf_counter()
            if remaining <= 0.0:
                return
            if commands.answered:
                time.sleep(remaining)
                return

    def _pass_time(self, commands: Commands) -> None:
        """Let the devices sample, until a period has passed by their clock.

        A silent bus is waited for only once; the watchdogs of its controllers hold the joints.
        """
        clock, began = self._time, time.monotonic()
        self._sample()
        while (remaining := clock.remaining) and not clock.is_lost and time.monotonic() - began <= LONGEST_WAIT:
            self._wait(commands, remaining)
            self._pacer.restart(1.0)  # a shorter wait for the next period would be too short, too
            self._sample()
        clock.end_period(lost=remaining > 0.0)

    def _pass_on(self, commands: Commands) -> None:
        arbiter = commands.arbiter
        motor, admitted, self._admitted = arbiter.motor, self._admitted, arbiter.admitted
        if motor is None:
            return
        if arbiter.silent and not arbiter.limp:
            if self._held is None:
                self._held = holding(motor, self._senses.position, self._senses.effort)
            self._send(self._held)
        elif arbiter.silent or arbiter.admitted != admitted:
            self._held = None
            self._send(motor)  # a limp one every period: without commands the motor controllers would hold the joints

    def _send(self, motor: Motor) -> None:
        """Send a valid Motor to the devices; set-points are clamped to the joints' limits here."""
        robot = self._robot
        position = np.minimum(np.maximum(motor.position, robot.lower), robot.upper)
        effort = np.minimum(np.maximum(motor.effort, -robot.effort_limit), robot.effort_limit)
        self._motor_sequence = motor.sequence
        vectors = (position, motor.velocity, effort, motor.stiffness, motor.damping)
        for device in self._moving:
            joints = device.joints
            command = JointCommands(motor.sequence, motor.mode[joints], *(each[joints] for each in vectors))
            self._attempt(device, device.send, command)

    def measure(self, sequence: int) -> Proprioceptor:
        return self._senses.measure(self._time.now, sequence, self._motor_sequence, self._watch.primary)

    def attend(self) -> None:
        """Check the devices; report them on changes, and every second."""
        primary = self._watch.primary
        if self._watch.update(self._time.now):
            self.demand = self._watch.reaction
            self._status.publish(self._watch.report(self._time.now))
            self._senses.update_voltage()
        if self._watch.primary is not primary and self._watch.primary is not None:
            self._context.statistics.state("ready", f"the attitude is that of {self._watch.primary.name}")

    def pace(self) -> None:
        """Nothing: the period ended before its states were sampled."""

    def close(self) -> None:
        """End the threads; the motor controllers' watchdogs hold the joints."""
        self._stopping.set()
        for thread in self._threads:
            thread.join(timeout=1.0)
        for device in self._devices:
            device.close()
