"""What moves the joints: limits from the model or else by a stated rule; servo gains by weight and inertia."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.etree import ElementTree

import mujoco
import numpy as np

from valor.robot_setup.skeleton import Skeleton

TORQUE_LAG, DELAY = 0.005, 0.004  # of the hardware profile [s]
_LAG_MARGIN = 1.5  # of damping over lag times stiffness
_STEP_MARGIN = 0.35  # of damping times step over inertia: 2 is where a servo becomes unstable
STIFFNESS = {  # of a servo, of m·g·h, by role; ESCHER's
    "hip": 2.5,
    "ankle": 1.8,
    "waist": 1.25,
    "arm": 0.4,
    "neck": 0.2,
    "hand": 0.015,
}
DAMPING = 0.05  # of a servo, over its stiffness [s]


@dataclass
class Drive:
    """A joint's limits and gains, and why."""

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


def roles(robot: Skeleton) -> dict[int, str]:
    """Joint → role."""
    found: dict[int, str] = {}
    for leg in robot.legs.values():
        found |= dict.fromkeys(leg.joints, "hip") | dict.fromkeys(leg.joints[-2:], "ankle")
    found |= dict.fromkeys(robot.waist, "waist") | dict.fromkeys(robot.neck, "neck")
    for arm in robot.arms.values():
        found |= dict.fromkeys(arm.joints, "arm") | dict.fromkeys(arm.beyond, "hand")
    for joints in robot.others.values():
        found |= dict.fromkeys(joints, "neck")
    return found


def drives(robot: Skeleton, leg_length: float, weight: float) -> dict[int, Drive]:
    """Limits of every joint, without servo gains.

    Args:
        robot: the skeleton.
        leg_length: about [m].
        weight: of the robot [N].
    """
    mj, found = robot.source.mj, {}
    speeds = _urdf_velocities(robot)
    for joint, role in roles(robot).items():
        guesses: list[str] = []
        limited = bool(mj.jnt_limited[joint]) and mj.jnt_range[joint][0] < mj.jnt_range[joint][1]
        lower, upper = (float(x) for x in mj.jnt_range[joint])
        if not limited:
            lower, upper = _servo_range(robot, joint)
            guesses.append("range: none said of the joint; its actuator's, or half a turn")
        dof = int(mj.jnt_dofadr[joint])
        effort = _effort(robot, joint)
        if effort is None:
            share = {"hip": 0.35, "ankle": 0.2, "waist": 0.3, "arm": 0.06, "neck": 0.03, "hand": 0.005}[role]
            effort = share * weight * leg_length
            guesses.append(f"effort: {share:g} of weight times leg")
        velocity = speeds.get(mj.joint(joint).name)
        if velocity is None:
            velocity = {"hip": 12.0, "ankle": 12.0, "waist": 8.0, "arm": 6.0, "neck": 6.0, "hand": 4.0}[role]
            velocity *= min(2.0, max(1.0, (0.82 / leg_length) ** 0.5))
            guesses.append("velocity: usual for such a drive")
        armature = float(mj.dof_armature[dof])
        least = 5e-5 * effort
        if armature < least:
            armature = least
            guesses.append("armature: 5e-5 of the effort")
        damping = float(mj.dof_damping[dof])
        if damping > (most := 0.01 * effort):
            damping = most
            guesses.append("damping: that of the model is a servo's; 0.01 of the effort")
        control = "force" if role in ("hip", "ankle", "waist") else "impedance" if role == "arm" else "position"
        found[joint] = Drive(lower, upper, velocity, effort, armature, damping, role, control, guesses=guesses)
    return found


def tune(found: Mapping[int, Drive], inertia: Mapping[int, float], moment: float, step: float) -> None:
    """Servo gains: stiff by the weight that they carry, and bounded by inertia, step and lag.

    Args:
        found: drives, which get their gains.
        inertia: of each joint, the least that its servo moves [kg·m²].
        moment: m·g·h of the robot [N·m].
        step: of the physics [s].
    """
    for joint, drive in found.items():
        most = _STEP_MARGIN * inertia[joint] / step
        wanted = STIFFNESS[drive.role] * moment
        if drive.role in ("arm", "neck", "hand"):
            wanted = min(wanted, 4.0 * drive.effort / 0.5)
        damping = min(DAMPING * wanted, most)
        stiffness = min(wanted, damping / (_LAG_MARGIN * TORQUE_LAG))
        drive.stiffness, drive.servo_damping = _rounded(stiffness), _rounded(damping)


def inertias(robot: Skeleton, mj: mujoco.MjModel, data: mujoco.MjData) -> dict[int, float]:
    """Of every driven joint, what its servo moves when all others give way [kg·m²].

    Args:
        robot: the skeleton.
        mj: the generated model, with its joints' armature.
        data: in the nominal posture.
    """
    inverse = np.zeros((mj.nv, mj.nv))
    mujoco.mj_solveM(mj, data, inverse, np.eye(mj.nv))
    dofs = {joint: int(mj.joint(robot.joint_name(joint)).dofadr[0]) for joint in robot.driven}
    return {joint: 1.0 / float(inverse[dof, dof]) for joint, dof in dofs.items()}


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _effort(robot: Skeleton, joint: int) -> float | None:
    """The least of what the joint and its actuators are said to give [N·m]."""
    mj = robot.source.mj
    limits = []
    if mj.jnt_actfrclimited[joint]:
        limits.append(float(np.abs(mj.jnt_actfrcrange[joint]).max()))
    for actuator in range(mj.nu):
        if mj.actuator_trnid[actuator, 0] != joint:
            continue
        gear = abs(float(mj.actuator_gear[actuator, 0]))
        if mj.actuator_forcelimited[actuator]:
            limits.append(float(np.abs(mj.actuator_forcerange[actuator]).max()) * gear)
        motor = mj.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
        if motor and mj.actuator_ctrllimited[actuator]:
            gain = abs(float(mj.actuator_gainprm[actuator, 0]))
            limits.append(float(np.abs(mj.actuator_ctrlrange[actuator]).max()) * gear * gain)
    limits = [limit for limit in limits if 0 < limit < 5000]
    return min(limits) if limits else None


def _servo_range(robot: Skeleton, joint: int) -> tuple[float, float]:
    """Of a joint without limits: what its position actuator takes, within half a turn [rad]."""
    mj = robot.source.mj
    for actuator in range(mj.nu):
        servo = mj.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
        if mj.actuator_trnid[actuator, 0] == joint and servo and mj.actuator_ctrllimited[actuator]:
            low, high = (float(np.clip(x, -3.1, 3.1)) for x in mj.actuator_ctrlrange[actuator])
            return low, high
    return -3.1, 3.1


def _urdf_velocities(robot: Skeleton) -> dict[str, float]:
    """What a URDF says of its joints' speeds, which MuJoCo does not read [rad/s]."""
    try:
        root = ElementTree.fromstring(robot.source.file.read_bytes())
    except ElementTree.ParseError:
        return {}
    limits = {joint.get("name", ""): joint.find("limit") for joint in root.findall("joint")}
    speeds = {name: float(limit.get("velocity", "0")) for name, limit in limits.items() if limit is not None}
    return {name: min(speed, 100.0) for name, speed in speeds.items() if speed > 0}
