"""The real devices behind the main loop: find them, switch them on, and exchange states and commands every period.

::

    period     |<------------------------ control period ------------------------>|
    main loop  SYNC → gather → Proprioceptor ── wait for Motor ──→ hand out, sleep → SYNC …
    devices       their threads, at their own rates
"""

from __future__ import annotations

import logging
import math
import sys
import threading
import time
from collections import Counter

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
from valor.comms_manager.hardware.can_device import GATHERING, CanDevice
from valor.comms_manager.hardware.device import (
    Ailment,
    Device,
    DeviceContext,
    DeviceError,
    Fault,
    ImuMeasurement,
    JointCommands,
    JointMeasurement,
    WrenchMeasurement,
)
from valor.comms_manager.hardware.faults import DeviceWatch
from valor.comms_manager.hardware.force_torque import ForceTorque
from valor.comms_manager.hardware.holding import holding
from valor.comms_manager.hardware.kinds import make
from valor.comms_manager.hardware.microstrain import MicroStrain
from valor.comms_manager.hardware.series_elastic import SeriesElastic
from valor.service import Context

FEET = ("left_foot", "right_foot")  # where the forces must be known
# So much may lack of a period. Less than half, or whoever is late once samples twice a period for ever; and no whole
# millisecond of 4 or 5 ms, the grain of an emulator's clock.
LACKING = 0.45
LONGEST_WAIT = 1.0  # for the leg controllers' clocks [s]
NOMINAL_VOLTAGE = 48.0  # of the battery, until a unit says otherwise [V]
# Five threads share the interpreter: whoever waits for it is to wait less than the five milliseconds of the default.
_SWITCH_INTERVAL = 0.0005
_log = logging.getLogger("comms_manager")


class Hardware(Backend):
    """All devices of robot.yaml."""

    waits_for_motor = False  # the robot's time passes by itself

    def __init__(self, context: Context) -> None:
        self._context, robot = context, context.robot
        self._robot = robot
        n = len(robot.joints)
        self._devices: list[Device] = []
        self._threads: list[threading.Thread] = []
        self._stopping = threading.Event()
        device_context = DeviceContext(context.instance, context.settings, robot)
        try:
            for name in robot.tables.devices:
                self._devices.append(make(name, device_context))
            self._require_complete()
            self._start()
        except DeviceError as error:
            self.close()
            raise ConfigurationError(str(error)) from None
        except BaseException:
            self.close()
            raise
        self._synchronous = [device for device in self._devices if isinstance(device, CanDevice)]
        self._moving = [device for device in self._devices if len(device.joints)]
        self._watch = DeviceWatch(self._devices)
        self._status = DEVICES.publisher(context.node)
        self._pacer = Pacer(1.0, Wall())
        self._admitted = 0
        self._motor_sequence = 0
        self._held: Motor | None = None  # while nobody leads the joints
        self._lost = False  # the leg controllers' clock is: a period is a period
        self._reference = next((device for device in self._devices if isinstance(device, SeriesElastic)), None)
        self._begin()
        self._position, self._velocity, self._effort = np.zeros(n), np.zeros(n), np.zeros(n)
        self._imu = ImuMeasurement(0, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
        self._wrenches = {place: np.zeros(6) for place in ("left_foot", "right_foot", "left_hand", "right_hand")}
        self._voltage = NOMINAL_VOLTAGE

    def _require_complete(self) -> None:
        """Raise ``ConfigurationError`` unless devices move each joint once, and feel what balance is kept by."""
        robot, tables = self._robot, self._robot.tables
        moved = Counter(joint for name in tables.devices for joint in tables.device_joints(name))
        sensors = [device for device in self._devices if isinstance(device, ForceTorque)]
        felt = Counter[str](place for sensor in sensors for place in sensor.places)
        lacking = []
        if missing := [joint for joint in robot.joints if not moved[joint]]:
            lacking.append(f"none moves {', '.join(missing)}")
        if (imus := sum(isinstance(device, MicroStrain) for device in self._devices)) != 1:
            lacking.append(f"{imus} IMUs; expected one, for the pelvis' attitude")
        if missing := [place for place in FEET if not felt[place]]:
            lacking.append(f"no force/torque sensor at {', '.join(missing)}; expected one in each foot")
        if twice := [what for what, count in (moved + felt).items() if count > 1]:
            lacking.append(f"{', '.join(twice)}: in more than one device")
        if lacking:
            raise ConfigurationError(f"{robot.folder / 'robot.yaml'}: devices: {'; '.join(lacking)}")

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

    def _begin(self) -> None:
        """Have the devices sample twice: the time by the leg controllers' clock begins with that."""
        for _ in range(2):
            self._sample()
        self._elapsed = self._reference.elapsed if self._reference else 0
        self._time = time.monotonic_ns() - self._context.settings.epoch  # robot time of the newest states [ns]

    def _sample(self) -> None:
        for device in self._synchronous:
            device.request_states()
        for device in self._synchronous:
            device.gathered.wait(2.0 * GATHERING)

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
        return max(0.0, 1e-9 * (time.monotonic_ns() - self._context.settings.epoch - self._time))

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
        """Have the devices sample, until by their clocks a period has passed since they were heard last.

        The leg controllers' clock is the robot's, as a bus' reference clock is in distributed clocks: emulators on a
        computer that is too slow are slow robots, not wrong ones.
        """
        period, reference, began = self._robot.control_period, self._reference, time.monotonic()
        while True:
            self._sample()
            if reference is None:
                break
            elapsed = reference.elapsed - self._elapsed
            lacking = period - 1e-9 * elapsed
            if lacking < LACKING * period:
                self._lost = False
                break
            # A bus on which nobody speaks is waited for: its controllers' watchdogs hold the joints meanwhile.
            if self._lost or time.monotonic() - began > LONGEST_WAIT:
                self._lost = True
                break
            self._wait(commands, lacking)
        if reference is None or self._lost:
            elapsed = round(1e9 * period)
        if reference is not None:
            self._elapsed = reference.elapsed
        self._time += elapsed

    def _hand_out(self, commands: Commands) -> None:
        leader = commands.leader
        if leader.silent and leader.limp and leader.motor is not None:
            self._held = None
            self._send(leader.motor)  # again and again: the motor controllers would hold a joint that hears nothing
        elif leader.silent and leader.motor is not None:
            if self._held is None:
                self._held = holding(leader.motor, self._position, self._effort)
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
        for device in self._devices:
            measured = device.measured
            if isinstance(measured, JointMeasurement):
                places = device.joints
                self._position[places] = measured.position
                self._velocity[places] = measured.velocity
                self._effort[places] = measured.effort
            elif isinstance(measured, ImuMeasurement):
                self._imu = measured
            elif isinstance(measured, WrenchMeasurement) and isinstance(device, ForceTorque):
                for place, wrench in zip(device.places, measured.wrench, strict=True):
                    self._wrenches[place] = wrench
        imu, wrenches = self._imu, self._wrenches
        return Proprioceptor(
            time=self._time,
            sequence=sequence,
            motor_sequence=self._motor_sequence,
            joint_position=self._position.copy(),
            joint_velocity=self._velocity.copy(),
            joint_effort=self._effort.copy(),
            imu_orientation=imu.orientation,
            imu_angular_velocity=imu.angular_velocity,
            imu_linear_acceleration=imu.linear_acceleration,
            left_foot_wrench=wrenches["left_foot"],
            right_foot_wrench=wrenches["right_foot"],
            left_hand_wrench=wrenches["left_hand"],
            right_hand_wrench=wrenches["right_hand"],
            battery_voltage=self._voltage,
            motor_behavior="",
        )

    def attend(self) -> None:
        """Watch the devices; report them when something changes, and every second."""
        if self._watch.update(self._time):
            self.demand = self._watch.reaction.name.lower()
            self._status.publish(self._watch.report(self._time))
            voltages = [record.voltage for device in self._moving for record in device.records]
            if known := [voltage for voltage in voltages if not math.isnan(voltage)]:
                self._voltage = min(known)

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
