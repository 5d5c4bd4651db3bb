"""The robot that the emulated devices sit in: the plant, as devices feel and move it."""

from __future__ import annotations

import time

import numpy as np
import numpy.typing as npt
from msgspec import structs

from valor_common.devices.table import SeaCanFd
from valor_common.instance import Settings
from valor_common.messages import JointMode, Motor, Proprioceptor
from valor_common.robot import RobotDescription
from valor_simulation.plant import Plant
from valor_simulation.sensors import Sensors

Places = npt.NDArray[np.intp]
STALENESS = 0.012  # of the newest command to the drives that carry it, from which on time stands still [s of the robot]
PATIENCE = 1.0  # and until when [s on the wall]


class SimulatedRobot:
    """A plant whose joints are commanded device by device.

    A robot is switched on hanging from a gantry. Here the world stands still, in the nominal posture, until the drives
    of all series-elastic actuators are on and hold it; then it is let go, once and for all.

    Attributes:
        description: robot.yaml.
        plant: MuJoCo.
        released: whether the robot has been let go of.
        time: that has passed for the robot and in its devices' clocks [s].
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
        self._motor = Motor(0, 0, 0, np.zeros(n, dtype=np.uint8), *(np.zeros(n) for _ in range(5)))
        self._changed = False
        self._powered = np.zeros(n, dtype=bool)
        carrying = [
            joint for device in tables.devices.values() if isinstance(device, SeaCanFd) for joint in device.joints
        ]
        self._carrying: Places = np.array([description.index[joint] for joint in carrying], dtype=np.intp)
        self._carries = np.zeros(n, dtype=bool)
        self._carries[self._carrying] = True
        self._measured: Proprioceptor | None = None
        # When commands to what carries it came last, in the robot's time and the wall's [s].
        self._commanded: tuple[float, float] | None = None
        self.released = not carrying
        self.time = 0.0

    @property
    def measured(self) -> Proprioceptor:
        """What perfect devices with the profile's noise would say now; the same until the plant has moved on."""
        if self._measured is None:
            self._measured = self._sensors.measure(0, round(self.time * 1e9))
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
            self._commanded = self.time, time.monotonic()

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

    @property
    def waits(self) -> bool:
        """Whether time should stand still: commands came, and then none for a moment that is no silence yet.

        A computer that stalls is to slow the world down, not to fell the robot; one that ended leaves it to the drives'
        watchdogs.
        """
        if self._commanded is None or self.time - self._commanded[0] <= STALENESS:
            return False
        return time.monotonic() - self._commanded[1] < PATIENCE
