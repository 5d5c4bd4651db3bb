"""Tables of robot.yaml: the parts of a robot. ``motion_tables.py`` has the limits of its motion."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from msgspec import Meta

from valor.common.arrays import FloatArray
from valor.common.table import NonNegative, Positive, Table, TableError, require_order
from valor.devices.kinds import DeviceTable
from valor.devices.table import Calibration, SupplyLimits
from valor.robot.batteries import Batteries
from valor.robot.motion_tables import Controllers, Footsteps, PelvisMotion, SelfCollision, Walking
from valor.robot.size import Force, Size

WHOLE_BODY_GROUPS = ("left_leg", "right_leg", "torso", "left_arm", "right_arm")
"""Groups whose joints the Whole-Body Controller moves; the others are welded in its model."""

Turn = Annotated[float, Meta(ge=-13, le=13)]
"""Angle of at most two turns [rad]; a larger value is probably in degrees."""
Share = Annotated[float, Meta(ge=0, lt=1)]
Side = Literal["left", "right"]
SIDES = ("left", "right")
Lag = Annotated[float, Meta(ge=0, le=0.1)]  # [s]


class Servo(Table):
    """Gains of a joint's position servo."""

    stiffness: NonNegative  # [N·m/rad]
    damping: NonNegative  # [N·m·s/rad]


class Joint(Table, kw_only=True):
    """Actuated joint. A continuous joint has neither ``lower`` nor ``upper``."""

    lower: Turn | None = None  # [rad]
    upper: Turn | None = None  # [rad]
    velocity: Annotated[float, Meta(gt=0, le=100)]  # limit [rad/s]
    effort: Annotated[float, Meta(gt=0, le=5000)]  # limit [N·m]
    control: Literal["force", "impedance", "position"]  # mode of the Motion Manager in operation
    servo: Servo  # used in Idle, Stand Prep, Freeze, and in operation unless control is force
    armature: NonNegative = 0.0  # rotor inertia seen at the joint [kg·m²]
    damping: NonNegative = 0.0  # viscous [N·m·s/rad]

    def __post_init__(self) -> None:
        if (self.lower is None) != (self.upper is None):
            raise TableError((), "expected both lower and upper, or neither; got one of them")
        if self.lower is not None:
            require_order(self, "lower", "upper")


class Passive(Table):
    """Hinge without a drive; model.xml has its range, spring, damping and couplings."""

    at: Turn = 0.0  # rest position in the nominal posture; fixed there in the controllers' model [rad]
    simulated: bool = True  # whether it moves in simulation; welded otherwise


class Foot(Table):
    """Foot: its body, and the site at the sole's origin (x forward, z up, on the contact surface)."""

    body: str
    sole: str
    heel: float  # x of the sole's back edge in the sole's frame [m]
    toe: float  # x of the front edge [m]
    half_width: Positive  # [m]

    def __post_init__(self) -> None:
        require_order(self, "heel", "toe")


class Hand(Table):
    """Hand: its body, and the site that hand poses and wrenches refer to."""

    body: str
    site: str


class Feet(Table):
    """Both feet."""

    left: Foot
    right: Foot


class Hands(Table):
    """Hands of the robot."""

    left: Hand | None = None
    right: Hand | None = None
    contact_on: Force[Positive] = 15.0  # contact force above which a hand is in contact [N]
    contact_off: Force[Positive] = 8.0  # contact force below which contact ends [N]
    most_pressing: Force[Positive] = 60.0  # largest contact force of a hand goal; above it the goal is released [N]

    def __post_init__(self) -> None:
        require_order(self, "contact_off", "contact_on")
        require_order(self, "contact_on", "most_pressing")

    def present(self) -> Iterator[tuple[Side, Hand]]:
        """Yield side and table of each hand, left first."""
        if self.left is not None:
            yield "left", self.left
        if self.right is not None:
            yield "right", self.right


class Imu(Table):
    """IMU on the pelvis."""

    site: str
    accelerometer: bool = True  # without, a quasi-static robot is assumed: gravity alone, by the attitude


class Lidar(Table):
    """Rolling lidar; its x axis is the spindle's."""

    body: str  # which the spindle moves
    position: tuple[float, float, float]  # of the beams' origin in it [m]


class Camera(Table):
    """Multisense S7."""

    body: str  # that carries it
    position: tuple[float, float, float]  # of the left camera in it [m]
    pitch: float  # viewing angle below the body's x axis [rad]


class SensorNoise(Table):
    """Standard deviations of white noise, and constant biases, of simulated devices."""

    joint_position: Annotated[float, Meta(ge=0, le=0.05)] = 0.0  # [rad]
    joint_position_resolution: Annotated[float, Meta(ge=0, le=0.05)] = 0.0  # encoder quantum [rad]
    joint_velocity: Annotated[float, Meta(ge=0, le=5)] = 0.0  # [rad/s]
    joint_effort: NonNegative = 0.0  # [N·m]
    orientation: Annotated[float, Meta(ge=0, le=0.1)] = 0.0  # IMU attitude [rad]
    orientation_bias: Annotated[float, Meta(ge=0, le=0.1)] = 0.0  # constant, roll and pitch, drawn from the seed [rad]
    gyroscope: Annotated[float, Meta(ge=0, le=1)] = 0.0  # [rad/s]
    accelerometer: Annotated[float, Meta(ge=0, le=10)] = 0.0  # [m/s²]
    force: NonNegative = 0.0  # [N]
    torque: NonNegative = 0.0  # [N·m]


class Gear(Table):
    """Motor and gear of a joint that differs from the profile's defaults."""

    friction: NonNegative | None = None  # Coulomb, at the joint [N·m]; default: the profile's
    backlash: NonNegative | None = None  # peak to peak [rad]; default: the profile's
    feed_forward: bool = True  # whether the device applies Motor's effort; without, gravity is not compensated
    strength: Annotated[float, Meta(ge=0, le=1)] = 1.0  # share of the motor's torque that reaches the joint


class Springs(Table, kw_only=True):
    """Linear series-elastic actuators and their device's force loop. The joint's ``armature`` is the motors'."""

    stiffness: Positive  # of an actuator's spring [N/m]
    force: Positive  # largest of an actuator [N]; its arm is the joint's effort limit by the force of all its actuators
    # Joint → number of actuators in parallel.
    actuators: Annotated[dict[str, Annotated[int, Meta(ge=1)]], Meta(min_length=1)]
    bandwidth: Annotated[float, Meta(gt=0, le=100)]  # of the force loop with the joint locked [Hz]
    observer: Annotated[float, Meta(ge=0, le=100)]  # of its disturbance observer [Hz]


class ActuatorProfile(Table):
    """Differences of the simulated plant from the controller's model."""

    mass_error: Share = 0.0  # relative error of each body's mass and inertia, uniform, drawn from the seed
    friction: NonNegative = 0.0  # Coulomb friction of every joint [N·m], at most friction_share of its effort limit
    friction_share: Share = 0.02  # of the effort limit: keeps fingers and neck movable
    torque_lag: Lag = 0.0  # time constant of the torque's first-order lag [s]
    delay: Lag = 0.0  # of commands [s]
    backlash: NonNegative = 0.0  # of position-controlled and impedance-controlled joints, peak to peak [rad]
    gears: dict[str, Gear] = {}  # by joint or group; a joint's entry has precedence
    springs: Springs | None = None  # None: motors turn the joints themselves
    noise: SensorNoise = SensorNoise()


ControlRate = Annotated[float, Meta(ge=100, le=1000, extra={"unit": "Hz"})]
"""Control rate [Hz]. Undisturbed and without delays ESCHER stands at 25 Hz and falls at 10 Hz."""

Presets = dict[str, dict[Side, dict[str, float]]]
"""Name of a posture → side → joint → position."""


class ArmPd(Table):
    """Gains of the arms' PD control (``arm_control: pd``), as little tuned as the thesis' (5.3.1)."""

    gain: Positive = 3.0  # velocity set-point per position error [1/s]
    damping: NonNegative = 0.1  # velocity set-point per velocity error
    horizon: Positive = 0.1  # position set-point from the measured position, per excess of that velocity [s]

    def stiffness(self, servo_stiffness: FloatArray, servo_damping: FloatArray) -> FloatArray:
        """Return the torque per position error at rest, of servos with these gains [N·m/rad, N·m·s/rad]."""
        return self.gain * (self.horizon * servo_stiffness + servo_damping)


Section = dict[str, Any]
"""Table that its reader defines and checks; see ``RobotDescription.read``."""


class RobotTables(Table, kw_only=True):
    """Content of robot.yaml; ``checks/tables.py`` has the consistency checks."""

    name: str
    model: str  # MJCF file in the robot's folder
    control_rate: ControlRate  # [Hz]
    # Of the simulation [s]; contacts become unstable above.
    physics_step: Annotated[float, Meta(ge=1e-4, le=0.005, extra={"unit": "s"})]
    size: Size  # scales the defaults below
    base: str  # floating body, the pelvis
    chest: str  # body that pushes act on and whose orientation is controlled
    head: str | None = None
    imu: Imu  # of the estimate
    kvh: Imu | None = None  # second IMU, a KVH 1750
    lidar: Lidar | None = None
    camera: Camera | None = None
    feet: Feet
    hands: Hands = Hands()
    joints: dict[str, Joint]  # in the order of every joint vector
    passive: dict[str, Passive] = {}  # other hinges of the model
    groups: dict[str, list[str]]  # left_leg, right_leg; torso, left_arm, … if present
    nominal_posture: dict[str, float]  # [rad]; default 0
    nominal_base_height: Positive  # of the base's origin above the soles in the nominal posture [m]
    arm_presets: Presets = {}  # [rad]
    hand_presets: Presets = {}  # [rad]
    actuators: dict[str, ActuatorProfile]  # profiles: ideal, hardware
    fall: Section = {}
    footsteps: Footsteps | None = None  # absent: no footstep plans; {}: defaults of its size
    whole_body: Section = {}
    walking: Walking = Walking()
    controllers: Controllers = Controllers()
    pelvis: PelvisMotion = PelvisMotion()
    disturbance: Section = {}
    gains: Section = {}
    arm_servos: Section = {}
    # Of arms that balance: servos compensated for weight, friction and play, or the thesis' PD control without that.
    arm_control: Literal["compensated", "pd"] = "compensated"
    arm_pd: ArmPd = ArmPd()
    weight_factor: Annotated[float, Meta(ge=1)] = 4.0  # largest factor of a task's weight, up or down
    hand_goals: Section = {}
    self_collision: SelfCollision = SelfCollision()
    estimator: Section = {}
    link_frames: dict[str, str] = {}  # ROS frame (REP-120) → body or site of the model
    devices: dict[str, DeviceTable] = {}  # on hardware, by name, in the order of start-up
    calibration: Calibration = Calibration()
    supply: SupplyLimits = SupplyLimits()
    batteries: Batteries | None = None

    @property
    def feet_are_sensed(self) -> bool:
        """Whether ``devices`` list force/torque sensors in both feet; else their wrenches are estimated."""
        places = {place for device in self.devices.values() for place in device.places}
        return {"left_foot", "right_foot"} <= places

    def group(self, name: str) -> list[str]:
        """Return a group's joints in order; empty if the robot lacks the limb."""
        return self.groups.get(name, [])

    def device_joints(self, name: str) -> list[str]:
        """Return the joints that a device drives, in the order of its units."""
        device = self.devices[name]
        return [*device.joints, *(joint for group in device.groups for joint in self.groups[group])]

    def device_carries(self, name: str) -> bool:
        """Return whether a device carries the robot, i.e. drives force-controlled joints."""
        return any(self.joints[joint].control == "force" for joint in self.device_joints(name))
