"""The robot that the emulated devices sit in: the plant, as devices feel and move it."""

from __future__ import annotations

import time
from collections import deque

import numpy as np
import numpy.typing as npt
from msgspec import structs

from valor.common.instance import Settings
from valor.common.messages import JointMode, Motor, Proprioceptor
from valor.common.rotation import conjugate, rotate
from valor.robot.description import RobotDescription
from valor.simulation.plant import Plant
from valor.simulation.sensors import Sensors

Places = npt.NDArray[np.intp]
STALENESS = 3  # of the newest command to the drives that carry it, from which on time stands still [control periods]
PATIENCE = 1.0  # and until when [s on the wall]
LONGEST = 0.012  # that is made up at once of what a stall of the emulators has cost [s]


class SimulatedRobot:
    """A plant whose joints are commanded device by device.

    A robot is switched on hanging from a gantry. Here the world stands still, in the nominal posture, until the drives
    that carry it are on and hold it; then it is let go, once and for all.

    Attributes:
        description: robot.yaml.
        plant: MuJoCo.
        released: whether the robot has been let go of.
        time: that has passed for the robot and in its devices' clocks [s].
        slip: time that has not passed for it, but on the wall [s].
        commands: how old commands became before the next came.
    """

    def __init__(self, description: RobotDescription, settings: Settings) -> None:
        # Commands are late by what ports and drives take, so the profile's own delay is left out.
        profile = structs.replace(description.tables.actuators[settings.actuators], delay=0.0)
        tables = structs.replace(description.tables, actuators={settings.actuators: profile})
        description = RobotDescription(description.folder, tables)
        self.description = description
        self.plant = Plant(description, settings.world, settings.actuators, settings.seed)
        self._sensors = Sensors(description, self.plant, profile.noise, settings.seed)
        n = len(description.joints)
        # Arrays of their own: each device writes its joints' places.
        position, velocity, effort, stiffness, damping = (np.zeros(n) for _ in range(5))
        modes = np.zeros(n, dtype=np.uint8)
        self._motor = Motor(0, 0, 0, modes, position, velocity, effort, stiffness, damping, behavior="", writer=0)
        self._changed = False
        self._powered = np.zeros(n, dtype=bool)
        carrying = [
            joint for name in tables.devices if tables.device_carries(name) for joint in tables.device_joints(name)
        ]
        self._carrying: Places = np.array([description.index[joint] for joint in carrying], dtype=np.intp)
        self._carries = np.zeros(n, dtype=bool)
        self._carries[self._carrying] = True
        self._measured: Proprioceptor | None = None
        # When commands to what carries it came last, in the robot's time and the wall's [s]; before the first, when its
        # drives were asked for their states.
        self._heard: tuple[float, float] | None = None
        self._is_commanded = False
        self._staleness = STALENESS * description.control_period
        self.released = not carrying
        self.time = 0.0
        self.slip = 0.0
        self.commands = CommandAges()
        self._began: float | None = None  # on the wall, when time was 0 or would have been without slip [s]

    @property
    def measured(self) -> Proprioceptor:
        """What perfect devices with the profile's noise would say now; the same until the plant has moved on."""
        if self._measured is None:
            self._measured = self._sensors.measure(0, round(self.time * 1e9))
            if not self.released:  # to MuJoCo it falls; who hangs from a gantry feels what holds him
                w, x, y, z = self._measured.imu_orientation.tolist()
                gx, gy, gz = self.plant.model.mj.opt.gravity.tolist()
                self._measured.imu_linear_acceleration = np.array(rotate(conjugate((w, x, y, z)), (-gx, -gy, -gz)))
        return self._measured

    def power(self, joints: Places, on: bool) -> None:
        """Switch the drives of joints on or off; off, they are limp."""
        self._powered[joints] = on
        if not on:
            self._motor.mode[joints] = JointMode.OFF
            self._changed = True
        elif not self.released and self._powered[self._carrying].all():
            self.released = True

    def command(
        self,
        joints: Places,
        *,
        mode: npt.ArrayLike,
        position: npt.ArrayLike,
        velocity: npt.ArrayLike,
        effort: npt.ArrayLike,
        stiffness: npt.ArrayLike,
        damping: npt.ArrayLike,
    ) -> None:
        """Have the drives of joints obey, from the next step on; fields as in ``Motor``, for those joints."""
        motor = self._motor
        motor.mode[joints] = np.where(self._powered[joints], mode, JointMode.OFF)
        motor.position[joints] = position
        motor.velocity[joints] = velocity
        motor.effort[joints] = effort
        motor.stiffness[joints] = stiffness
        motor.damping[joints] = damping
        self._changed = True
        if self._carries[joints[0]]:
            if self._is_commanded and self._heard is not None:
                self.commands.came(self.time - self._heard[0])
            self._is_commanded, self._heard = True, (self.time, time.monotonic())

    def asked(self) -> None:
        """The drives that carry it were asked for their states: somebody is there who will command them."""
        if self.released and not self._is_commanded:
            self._heard = self.time, time.monotonic()

    def hold(self, joints: Places) -> None:
        """Have the drives of joints hold them where their encoders say they are, on the joints' own servos."""
        motor = self._motor
        motor.mode[joints] = np.where(self._powered[joints], JointMode.POSITION, JointMode.OFF)
        motor.position[joints] = self.measured.joint_position[joints]
        for vector in (motor.velocity, motor.effort):
            vector[joints] = 0.0
        self._changed = True

    def advance(self, steps: int) -> None:
        """Let physics steps pass, if the robot has been let go of.

        Raises:
            SimulationDivergedError: the state is not finite any more.
        """
        self.time += steps * self.plant.step_time
        if not self.released:
            return
        if self._changed:
            self._changed = False
            self.plant.actuators.obey(self._motor)
        self.plant.step(steps)
        self._measured = None

    def pass_until(self, now: float) -> None:
        """Let time pass until now [s on the wall, monotonic], as far as it may: a slow computer is a slow robot.

        Time stands still where drives were asked or commanded, and then not for a moment that is no silence yet: a
        computer that stalls is to slow the world down, not to fell the robot; one that ended leaves it to the drives'
        watchdogs.
        """
        step = self.plant.step_time
        if self._began is None:
            self._began = now - self.time
        behind = now - self._began - self.time
        due = int(behind / step)
        if due <= 0:
            return
        allowed = min(due, round(LONGEST / step))
        if self._heard is not None and now - self._heard[1] < PATIENCE:
            until = self._heard[0] + self._staleness - self.time
            allowed = min(allowed, max(0, round(until / step)))
        if allowed:
            self.advance(allowed)
        lost = (due - allowed) * step
        self._began += lost
        self.slip += lost


class CommandAges:
    """How old commands to the drives that carry the robot became, in its time, before the next ones came."""

    LAST = 1000  # batches

    def __init__(self) -> None:
        self._ages: deque[float] = deque(maxlen=self.LAST)

    def came(self, age: float) -> None:
        """A command came, the last one being so old [s]; those of one instant are one batch."""
        if age > 0.0:
            self._ages.append(age)

    def describe(self) -> str:
        """Mean, 99 % and longest of the last."""
        if not self._ages:
            return "no commands yet"
        mean, high, longest = np.mean(self._ages), np.percentile(self._ages, 99), max(self._ages)
        return f"commands {1e3 * mean:.1f} ms apart (99 %: {1e3 * high:.0f} ms, longest {1e3 * longest:.0f} ms)"
