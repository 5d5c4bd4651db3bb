"""Limits, dynamics and servo gains of joints: from the model, or by a stated rule."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.etree import ElementTree

import mujoco
import numpy as np

from valor.robot_setup.skeleton import Skeleton

TORQUE_LAG, DELAY = 0.005, 0.004  # of actuator profile ``hardware`` [s]
_LAG_MARGIN = 1.5  # minimum damping, relative to lag times stiffness
_STEP_MARGIN = 0.35  # maximum damping times step, relative to inertia; a servo becomes unstable at 2
STIFFNESS = {  # of a servo by role, relative to m·g·h; ESCHER's
    "hip": 2.5,
    "ankle": 1.8,
    "waist": 1.25,
    "arm": 0.4,
    "neck": 0.2,
    "hand": 0.015,
}
_BEARING = 0.6  # least stiffness of an ankle, relative to m·g·h: both together bear the inverted pendulum
DAMPING = 0.05  # of a servo, relative to its stiffness [s]
_EFFORT = {"hip": 0.35, "ankle": 0.2, "waist": 0.3, "arm": 0.06, "neck": 0.03, "hand": 0.005}  # of weight times leg
_VELOCITY = {"hip": 12.0, "ankle": 12.0, "waist": 8.0, "arm": 6.0, "neck": 6.0, "hand": 4.0}  # [rad/s]


@dataclass
class Drive:
    """Limits and gains of a joint, and the reasons of those that are guessed."""

    lower: float
    upper: float
    velocity: float
    effort: float
    armature: float
    damping: float
    role: str
    control: str
    stiffness: float = 0.0
    servo_damping: float = 0.0
    guesses: list[str] = field(default_factory=list)


def _roles(robot: Skeleton) -> dict[int, str]:
    found: dict[int, str] = {}
    for leg in robot.legs.values():
        found |= dict.fromkeys(leg.joints, "hip") | dict.fromkeys(leg.joints[-2:], "ankle")
    found |= dict.fromkeys(robot.waist, "waist") | dict.fromkeys(robot.neck, "neck")
    for arm in robot.arms.values():
        found |= dict.fromkeys(arm.joints, "arm") | dict.fromkeys(arm.fingers, "hand")
    for joints in robot.others.values():
        found |= dict.fromkeys(joints, "neck")
    return found


def find_drives(robot: Skeleton, leg_length: float, weight: float) -> dict[int, Drive]:
    """Return joint → limits and dynamics, without servo gains, for an approximate leg length [m] and a weight [N]."""
    mj, found = robot.source.mj, {}
    speeds = _urdf_velocities(robot)
    for joint, role in _roles(robot).items():
        guesses: list[str] = []
        lower, upper = (float(x) for x in mj.jnt_range[joint])
        if not (mj.jnt_limited[joint] and lower < upper):
            lower, upper = _servo_range(robot, joint)
            guesses.append("range: none of the joint; its actuator's, or half a turn")
        effort = _effort(robot, joint)
        if effort is None:
            effort = _EFFORT[role] * weight * leg_length
            guesses.append(f"effort: {_EFFORT[role]:g} of weight times leg")
        velocity = speeds.get(mj.joint(joint).name)
        if velocity is None:
            velocity = _VELOCITY[role] * min(2.0, max(1.0, (0.82 / leg_length) ** 0.5))
            guesses.append("velocity: usual for such a drive")
        dof = int(mj.jnt_dofadr[joint])
        armature, damping = float(mj.dof_armature[dof]), float(mj.dof_damping[dof])
        if armature < 5e-5 * effort:
            armature = 5e-5 * effort
            guesses.append("armature: 5e-5 of the effort")
        if damping > 0.01 * effort:
            damping = 0.01 * effort
            guesses.append("damping: that of the model is a servo's; 0.01 of the effort")
        control = "force" if role in ("hip", "ankle", "waist") else "impedance" if role == "arm" else "position"
        found[joint] = Drive(lower, upper, velocity, effort, armature, damping, role, control, guesses=guesses)
    return found


def set_gains(found: Mapping[int, Drive], inertia: Mapping[int, float], moment: float, step: float) -> bool:
    """Set servo gains: stiffness by the weight carried, bounded by inertia, physics step [s] and lag.

    Returns whether each ankle bears the robot. ``inertia``: minimum that each joint's servo moves [kg·m²];
    ``moment``: m·g·h of the robot [N·m].
    """
    for joint, drive in found.items():
        stiffness = STIFFNESS[drive.role] * moment
        if drive.role in ("arm", "neck", "hand"):
            stiffness = min(stiffness, 4.0 * drive.effort / 0.5)
        damping = min(DAMPING * stiffness, _STEP_MARGIN * inertia[joint] / step)
        stiffness = min(stiffness, damping / (_LAG_MARGIN * TORQUE_LAG))
        drive.stiffness, drive.servo_damping = float(f"{stiffness:.3g}"), float(f"{damping:.3g}")
    return all(drive.stiffness > _BEARING * moment for drive in found.values() if drive.role == "ankle")


def inertias(robot: Skeleton, mj: mujoco.MjModel, data: mujoco.MjData) -> dict[int, float]:
    """Return driven joint → inertia that its servo moves if all other joints are limp [kg·m²]."""
    inverse = np.zeros((mj.nv, mj.nv))
    mujoco.mj_solveM(mj, data, inverse, np.eye(mj.nv))
    dofs = {joint: int(mj.joint(robot.joint_name(joint)).dofadr[0]) for joint in robot.driven}
    return {joint: 1.0 / float(inverse[dof, dof]) for joint, dof in dofs.items()}


def _effort(robot: Skeleton, joint: int) -> float | None:
    """Return the lowest effort limit of a joint and its actuators [N·m]."""
    mj = robot.source.mj
    limits = []
    if mj.jnt_actfrclimited[joint]:
        limits.append(float(np.abs(mj.jnt_actfrcrange[joint]).max()))
    for actuator in np.flatnonzero(mj.actuator_trnid[:, 0] == joint):
        gear = abs(float(mj.actuator_gear[actuator, 0]))
        if mj.actuator_forcelimited[actuator]:
            limits.append(float(np.abs(mj.actuator_forcerange[actuator]).max()) * gear)
        motor = mj.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
        if motor and mj.actuator_ctrllimited[actuator]:
            gain = abs(float(mj.actuator_gainprm[actuator, 0]))
            limits.append(float(np.abs(mj.actuator_ctrlrange[actuator]).max()) * gear * gain)
    return min((limit for limit in limits if 0 < limit < 5000), default=None)


def _servo_range(robot: Skeleton, joint: int) -> tuple[float, float]:
    """Return the range of the position actuator of a joint without limits, within half a turn [rad]."""
    mj = robot.source.mj
    for actuator in np.flatnonzero(mj.actuator_trnid[:, 0] == joint):
        servo = mj.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
        if servo and mj.actuator_ctrllimited[actuator]:
            low, high = (float(np.clip(x, -3.1, 3.1)) for x in mj.actuator_ctrlrange[actuator])
            return low, high
    return -3.1, 3.1


def _urdf_velocities(robot: Skeleton) -> dict[str, float]:
    """Return joint → velocity limit of a URDF, which MuJoCo does not read [rad/s]."""
    try:
        root = ElementTree.fromstring(robot.source.file.read_bytes())
    except ElementTree.ParseError:
        return {}
    limits = {joint.get("name", ""): joint.find("limit") for joint in root.findall("joint")}
    speeds = {name: float(limit.get("velocity", "0")) for name, limit in limits.items() if limit is not None}
    return {name: min(speed, 100.0) for name, speed in speeds.items() if speed > 0}
