"""The tables of robot.yaml: what a robot consists of. What it may be asked to do stands in ``motion_tables.py``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from msgspec import Meta

from valor.common.table import NonNegative, Positive, Table, TableError, require_order
from valor.devices.kinds import DeviceTable
from valor.devices.table import Calibration, SupplyLimits
from valor.robot.motion_tables import Footsteps, PelvisMotion, SelfCollision, Walking
from valor.robot.size import Force, Size

WHOLE_BODY_GROUPS = ("left_leg", "right_leg", "torso", "left_arm", "right_arm")
"""The groups whose joints the Whole-Body Controller moves; it sees the others welded."""

Turn = Annotated[float, Meta(ge=-13, le=13)]
"""Two turns either way [rad]: more is in degrees."""
Share = Annotated[float, Meta(ge=0, lt=1)]
Side = Literal["left", "right"]
Lag = Annotated[float, Meta(ge=0, le=0.1)]  # [s]


class Servo(Table):
    """Gains of a joint's own position servo."""

    stiffness: NonNegative  # [N·m/rad]
    damping: NonNegative  # [N·m·s/rad]


class Joint(Table, kw_only=True):
    """One actuated joint. ``lower`` and ``upper`` are absent where it turns without end."""

    lower: Turn | None = None  # [rad]
    upper: Turn | None = None  # [rad]
    velocity: Annotated[float, Meta(gt=0, le=100)]  # limit [rad/s]
    effort: Annotated[float, Meta(gt=0, le=5000)]  # limit [N·m]
    control: Literal["force", "impedance", "position"]  # how the Motion Manager drives it in operation
    servo: Servo  # used in Idle, Stand Prep, Freeze, and in operation where control is not force
    armature: NonNegative = 0.0  # rotor inertia seen at the joint [kg·m²]
    damping: NonNegative = 0.0  # viscous [N·m·s/rad]

    def __post_init__(self) -> None:
        if (self.lower is None) != (self.upper is None):
            raise TableError((), "expected both lower and upper, or neither; got one of them")
        if self.lower is not None:
            require_order(self, "lower", "upper")


class Passive(Table):
    """A hinge that nothing drives; its range, spring, damping and what couples it stand in model.xml."""

    at: Turn = 0.0  # where it rests in the nominal posture, and where controllers take it for fixed [rad]
    simulated: bool = True  # whether it moves in simulation; if not, it is welded there, too


class Foot(Table):
    """A foot: its body, and the site at the sole's origin (x forward, z up, on the contact surface)."""

    body: str
    sole: str
    heel: float  # x of the sole's back edge in the sole's frame [m]
    toe: float  # x of the front edge [m]
    half_width: Positive  # [m]

    def __post_init__(self) -> None:
        require_order(self, "heel", "toe")


class Hand(Table):
    """A hand: its body, and the site that hand poses and wrenches refer to."""

    body: str
    site: str


class Feet(Table):
    """Both feet."""

    left: Foot
    right: Foot


class Hands(Table):
    """The hands that a robot has."""

    left: Hand | None = None
    right: Hand | None = None
    contact_on: Force[Positive] = 15.0  # force from which a hand counts as touching something [N]
    contact_off: Force[Positive] = 8.0  # until here
    most_pressing: Force[Positive] = 60.0  # with which a hand goal may press on something; beyond, it is let go [N]

    def __post_init__(self) -> None:
        require_order(self, "contact_off", "contact_on")
        require_order(self, "contact_on", "most_pressing")

    def present(self) -> Iterator[tuple[Side, Hand]]:
        """Side and table of each, left first."""
        if self.left is not None:
            yield "left", self.left
        if self.right is not None:
            yield "right", self.right


class Imu(Table):
    """Where the pelvis IMU sits."""

    site: str


class SensorNoise(Table):
    """Standard deviations of white noise, and constant biases, of the simulated devices."""

    joint_position: NonNegative = 0.0  # [rad]
    joint_position_resolution: NonNegative = 0.0  # encoder quantum [rad]
    joint_velocity: NonNegative = 0.0  # [rad/s]
    joint_effort: NonNegative = 0.0  # [N·m]
    orientation: NonNegative = 0.0  # IMU attitude, white [rad]
    orientation_bias: NonNegative = 0.0  # roll and pitch, constant, drawn once from the seed [rad]
    gyroscope: NonNegative = 0.0  # [rad/s]
    accelerometer: NonNegative = 0.0  # [m/s²]
    force: NonNegative = 0.0  # [N]
    torque: NonNegative = 0.0  # [N·m]


class Gear(Table):
    """A joint's motor and gear, where they are not as the profile says of all joints."""

    friction: NonNegative | None = None  # Coulomb, at the joint [N·m]; absent: the profile's
    backlash: NonNegative | None = None  # peak to peak [rad]; absent: the profile's
    feed_forward: bool = True  # whether the device takes Motor's effort; if not, nothing carries the links' weight
    strength: Annotated[float, Meta(ge=0, le=1)] = 1.0  # share of the motor's torque that reaches the joint


class ActuatorProfile(Table):
    """How far the simulated plant is from the controller's model."""

    mass_error: Share = 0.0  # each body's mass and inertia times 1 ± this, drawn uniformly from the seed
    friction: NonNegative = 0.0  # Coulomb friction of every joint [N·m], at most friction_share of its effort limit
    friction_share: Share = 0.02  # so that fingers and neck are not stuck in a leg's friction
    torque_lag: Lag = 0.0  # time constant of the torque's first-order lag [s]
    delay: Lag = 0.0  # of commands [s]
    backlash: NonNegative = 0.0  # of position-controlled and impedance-controlled joints, peak to peak [rad]
    gears: dict[str, Gear] = {}  # of joints and groups; a joint's own goes first
    noise: SensorNoise = SensorNoise()


ControlRate = Annotated[float, Meta(ge=100, le=1000, extra={"unit": "Hz"})]
"""[Hz]. Undisturbed and without delays ESCHER still stands at 25 Hz, and falls at 10: this leaves room for both."""

Presets = dict[str, dict[Side, dict[str, float]]]
"""Name of a posture → side → joint → position."""


Section = dict[str, Any]
"""A table that its reader has beside itself, and checks: see ``RobotDescription.read``."""


class RobotTables(Table, kw_only=True):
    """robot.yaml as a whole; what must hold between its tables stands in ``rules.py``."""

    name: str
    model: str  # MJCF file in the robot's folder
    control_rate: ControlRate  # [Hz]
    physics_step: Annotated[
        float, Meta(ge=1e-4, le=0.005, extra={"unit": "s"})
    ]  # of the simulation; contacts bear no longer one [s]
    size: Size  # what the defaults of what follows go by
    base: str  # the floating body, the pelvis
    chest: str  # the body that pushes act on and whose orientation is held
    head: str | None = None
    imu: Imu
    feet: Feet
    hands: Hands = Hands()
    joints: dict[str, Joint]  # the order is that of every joint vector
    passive: dict[str, Passive] = {}  # all other hinges of the model
    groups: dict[str, list[str]]  # left_leg, right_leg; torso, left_arm, … where there are any
    nominal_posture: dict[str, float]  # [rad]; joints not named: 0
    nominal_base_height: Positive  # of the base's origin above the soles in the nominal posture [m]
    arm_presets: Presets = {}  # [rad]
    hand_presets: Presets = {}  # [rad]
    actuators: dict[str, ActuatorProfile]  # profiles: ideal, hardware
    fall: Section = {}
    footsteps: Footsteps | None = None  # absent: the robot takes no footstep plans; {}: those of a robot of its size
    whole_body: Section = {}
    walking: Walking = Walking()
    pelvis: PelvisMotion = PelvisMotion()
    disturbance: Section = {}
    gains: Section = {}
    arm_servos: Section = {}
    weight_factor: Annotated[float, Meta(ge=1)] = 4.0  # by which a task's weight may be changed, up or down
    hand_goals: Section = {}
    self_collision: SelfCollision = SelfCollision()
    estimator: Section = {}
    link_frames: dict[str, str] = {}  # ROS frame (REP-120) → body or site of the model
    devices: dict[str, DeviceTable] = {}  # on hardware, by name, in the order in which they are found and enabled
    calibration: Calibration = Calibration()
    supply: SupplyLimits = SupplyLimits()

    def group(self, name: str) -> list[str]:
        """A group's joints, in its order; none where the robot has no such limb."""
        return self.groups.get(name, [])

    def device_joints(self, name: str) -> list[str]:
        """The joints that a device moves, in its units' order."""
        device = self.devices[name]
        return [*device.joints, *(joint for group in device.groups for joint in self.groups[group])]

    def device_carries(self, name: str) -> bool:
        """Whether a device carries the robot: it moves joints that are driven by force."""
        return any(self.joints[joint].control == "force" for joint in self.device_joints(name))
