"""Simulated robot of the emulated devices: the plant with commands and measurements for each device."""

import time
from collections.abc import Mapping

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
STALENESS = 3  # age of the latest command to supporting drives at which robot time stops [control periods]
PAUSE_TIMEOUT = 1.0  # longest stop of robot time [s of wall clock]
RECENT = 0.005  # age of measurements of slow devices [s]
MAX_ADVANCE = 0.012  # longest robot time simulated at once after a stall of the emulators [s]


class SimulatedRobot:
    """Plant with joints commanded by separate devices.

    A real robot is switched on while it hangs from a gantry. Here the plant keeps the nominal posture until all drives
    that support the robot are on; then it is released, permanently.
    """

    def __init__(self, description: RobotDescription, settings: Settings) -> None:
        # Ports and drives delay commands already, so the delay of the profile is omitted.
        profile = structs.replace(description.tables.actuators[settings.actuators], delay=0.0)
        tables = structs.replace(description.tables, actuators={settings.actuators: profile})
        description = RobotDescription(description.folder, tables)
        self.description = description
        self.plant = Plant(description, settings.world, settings.actuators, settings.seed)
        self._sensors = Sensors(description, self.plant, profile.noise, settings.seed)
        n = len(description.joints)
        # Separate arrays: each device writes the elements of its joints.
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
        self._recent: Proprioceptor | None = None
        # Robot time and wall clock of the latest command to supporting drives [s]; before the first command, of the
        # latest request for their states.
        self._received: tuple[float, float] | None = None
        self._is_commanded = False
        self._staleness = STALENESS * description.control_period
        self.released = not carrying  # the plant is simulated
        self.time = 0.0  # robot time, also shown by the devices' clocks [s]
        self.slip = 0.0  # robot time lost against the wall clock [s]
        self._began: float | None = None  # wall clock at robot time 0, shifted by the slip [s]

    @property
    def measured(self) -> Proprioceptor:
        """Measurements with the noise of the profile; constant until the next step."""
        if self._measured is None:
            self._measured = self._sensors.measure(0, round(self.time * 1e9))
            self._recent = self._measured
            if not self.released:  # MuJoCo reports free fall; the gantry's support gives -gravity
                w, x, y, z = self._measured.imu_orientation.tolist()
                gx, gy, gz = self.plant.model.mj.opt.gravity.tolist()
                up = np.array(rotate(conjugate((w, x, y, z)), (-gx, -gy, -gz)))
                self._measured.imu_linear_acceleration = self._measured.kvh_linear_acceleration = up
        return self._measured

    @property
    def recent(self) -> Proprioceptor:
        """Measurements up to ``RECENT`` old, for devices with another cycle."""
        if self._recent is None or self.time - 1e-9 * self._recent.time > RECENT:
            self._recent = self.measured
        return self._recent

    def power(self, joints: Places, on: bool) -> None:
        """Switch the drives of joints on, or off (limp)."""
        self._powered[joints] = on
        if not on:
            self._motor.mode[joints] = JointMode.OFF
            self._changed = True
        elif not self.released and self._powered[self._carrying].all():
            self.released = True

    def command(self, joints: Places, mode: npt.ArrayLike, vectors: Mapping[str, npt.ArrayLike]) -> None:
        """Command the drives of joints from the next step; ``vectors``: five fields of ``Motor``, for these joints."""
        self._motor.mode[joints] = np.where(self._powered[joints], mode, JointMode.OFF)
        for name, value in vectors.items():
            getattr(self._motor, name)[joints] = value
        self._changed = True
        if self._carries[joints[0]]:
            self._is_commanded, self._received = True, (self.time, time.monotonic())

    def state_requested(self) -> None:
        """Record a state request to supporting drives: a driver is present, so commands will follow."""
        if self.released and not self._is_commanded:
            self._received = self.time, time.monotonic()

    def hold(self, joints: Places) -> None:
        """Hold joints at their measured positions, in position mode."""
        motor = self._motor
        motor.mode[joints] = np.where(self._powered[joints], JointMode.POSITION, JointMode.OFF)
        motor.position[joints] = self.measured.joint_position[joints]
        for vector in (motor.velocity, motor.effort):
            vector[joints] = 0.0
        self._changed = True

    def advance(self, steps: int) -> None:
        """Advance by physics steps, once released. Raises SimulationDivergedError: the state is not finite."""
        self.time += steps * self.plant.step_time
        if not self.released:
            return
        if self._changed:
            self._changed = False
            self.plant.actuators.obey(self._motor)
        self.plant.step(steps)
        self._measured = None

    def pass_until(self, now: float) -> None:
        """Advance robot time toward ``now`` [s of wall clock, monotonic]; the rest is added to the slip.

        Robot time stops while the latest command is older than ``STALENESS``, for up to ``PAUSE_TIMEOUT``. A stalled
        computer thus slows the robot instead of making it fall; after the timeout, the drives' watchdogs act.
        """
        step = self.plant.step_time
        if self._began is None:
            self._began = now - self.time
        behind = now - self._began - self.time
        due = int(behind / step)
        if due <= 0:
            return
        allowed = min(due, round(MAX_ADVANCE / step))
        if self._received is not None and now - self._received[1] < PAUSE_TIMEOUT:
            until = self._received[0] + self._staleness - self.time
            allowed = min(allowed, max(0, round(until / step)))
        if allowed:
            self.advance(allowed)
        lost = (due - allowed) * step
        self._began += lost
        self.slip += lost
