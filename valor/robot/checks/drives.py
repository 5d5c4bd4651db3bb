"""Checks of the drives: efforts carry the robot; servos hold it and are stable."""

from collections.abc import Iterator

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.table import TableError
from valor.robot.checks.stance import Stance
from valor.robot.tables import SIDES

STIFFNESS_MARGIN = 1.1  # of the ankles' stiffness over that of the inverted pendulum
STEP_MARGIN = 1.5  # largest (damping + stiffness·step)·step over inertia; 2 is unstable
_ROLLS = 0.9  # least cosine between a roll joint's axis and forward
_ITERATIONS = 6


def joints_can_carry_the_robot(stance: Stance) -> Iterator[TableError]:
    """Check effort limits in the nominal posture, on both feet and on one."""
    needed = {"the nominal posture": effort_shares(stance)}
    needed |= {f"standing on the {side} foot": one_leg_shares(stance, side) for side in SIDES}
    for name, joint in stance.robot.tables.joints.items():
        posture = max(needed, key=lambda posture: needed[posture].get(name, 0.0))
        share = needed[posture].get(name, 0.0)
        if share > 1:
            what = f"got {joint.effort}; expected at least {share * joint.effort:.1f} N·m, which {posture} needs"
            yield TableError(("joints", name, "effort"), what)


def effort_shares(stance: Stance) -> dict[str, float]:
    """Return each joint's torque in the nominal posture relative to its limit; the CoM's position divides the load."""
    model = stance.model
    torque: FloatArray = stance.data.qfrc_bias.copy()
    places = [stance.site(stance.foot(side).sole)[0] for side in SIDES]
    across = places[0] - places[1]
    share = float(np.clip((stance.com - places[1]) @ across / (across @ across), 0, 1))
    for side, place, load in zip(SIDES, places, (share, 1 - share), strict=True):
        point = np.array([stance.com[0], place[1], place[2]])
        jacobian = np.zeros((3, model.mj.nv))
        mujoco.mj_jac(model.mj, stance.data, jacobian, None, point, model.body(stance.foot(side).body))
        torque -= jacobian[2] * stance.weight * load
    return _shares(stance, torque)


def _shares(stance: Stance, torque: FloatArray) -> dict[str, float]:
    """Return |torque| of (nv,) generalized forces relative to the limits, by joint."""
    model = stance.model
    shares = np.abs(torque[model.dof]) / stance.robot.effort_limit[model.joint_indices]
    return dict(zip(model.joints, shares.tolist(), strict=True))


def one_leg_shares(stance: Stance, side: str) -> dict[str, float]:
    """Return the same on one foot, with the CoM above the sole's middle; empty with fewer than two roll joints."""
    model, foot = stance.model, stance.foot(side)
    forward, left = stance.base[1][:, 0], stance.base[1][:, 1]
    turns = {name: float(stance.data.joint(name).xaxis @ forward) for name in stance.robot.tables.group(f"{side}_leg")}
    rolls = [name for name, turn in turns.items() if abs(turn) > _ROLLS]
    if len(rolls) < 2:
        return {}
    ends = [(model.mj.joint(name).qposadr[0], sign * np.sign(turns[name])) for name, sign in
            ((rolls[0], 1.0), (rolls[-1], -1.0))]  # fmt: skip
    data, lean = mujoco.MjData(model.mj), 0.0
    for _ in range(_ITERATIONS):
        data.qpos[:] = model.nominal_qpos()
        for address, sign in ends:
            data.qpos[address] += sign * lean
        mujoco.mj_forward(model.mj, data)
        com, sole = data.subtree_com[model.body(stance.robot.tables.base)], data.site(foot.sole).xpos
        lean += float((com - sole) @ left) / float(com[2] - sole[2])
    torque: FloatArray = data.qfrc_bias.copy()
    jacobian = np.zeros((3, model.mj.nv))
    point = np.array([com[0], com[1], sole[2]])
    mujoco.mj_jac(model.mj, data, jacobian, None, point, model.body(foot.body))
    return _shares(stance, torque - jacobian[2] * stance.weight)


def servos_hold_the_robot_up(stance: Stance) -> Iterator[TableError]:
    """Check that the ankles' servos are stiffer than the inverted pendulum; only they hold the robot in Stand Prep."""
    ankles = [stance.pitch_joints(side)[-1:] for side in SIDES]
    if not all(ankles):
        yield TableError(("groups", "left_leg"), "expected joints that turn about the lateral axis")
        return
    needed = STIFFNESS_MARGIN * stance.weight * float(stance.com[2])
    found = sum(stance.robot.tables.joints[ankle].servo.stiffness for [ankle] in ankles)
    if found < needed:
        what = f"{found:g} N·m/rad in both ankles; expected at least {needed:.0f}, or the robot falls in Stand Prep"
        yield TableError(("joints", ankles[0][0], "servo", "stiffness"), what)
    for side in SIDES:
        for name in stance.robot.tables.group(f"{side}_leg"):
            if stance.robot.tables.joints[name].servo.stiffness == 0:
                what = "got 0.0; expected more, or the leg gives way in Stand Prep"
                yield TableError(("joints", name, "servo", "stiffness"), what)


def legs_are_fast_enough(stance: Stance) -> Iterator[TableError]:
    """Check velocity limits of the legs against lifting a sole by ``swing_height`` and lowering it in a swing."""
    walking = stance.robot.tables.walking
    for side in SIDES:
        lift = 4.0 * walking.swing_height / (walking.swing_duration * 0.5 * stance.leg_length(side))
        for name in stance.robot.tables.group(f"{side}_leg"):
            needed = lift if name in stance.pitch_joints(side) else 0.5 * lift
            if (velocity := stance.robot.tables.joints[name].velocity) < needed:
                what = f"got {velocity}; expected at least {needed:.2f} rad/s, which a step needs"
                yield TableError(("joints", name, "velocity"), what)


def efforts_move_the_joints(stance: Stance) -> Iterator[TableError]:
    """Check that a joint's effort reaches a tenth of its velocity limit within 1 s, by damping and armature."""
    for name, joint in stance.robot.tables.joints.items():
        most = 10.0 * joint.effort / joint.velocity
        for key, unit in (("damping", "N·m·s/rad"), ("armature", "kg·m²")):
            if (found := getattr(joint, key)) > most:
                what = f"got {found}; expected at most {most:.3g} {unit}, against which its effort moves it"
                yield TableError(("joints", name, key), what)


def servos_are_damped(stance: Stance) -> Iterator[TableError]:
    """Check damping ≥ T·stiffness for the torque lag T of each actuator profile; below, the servo oscillates."""
    for profile, actuators in stance.robot.tables.actuators.items():
        for name, joint in stance.robot.tables.joints.items():
            if (least := actuators.torque_lag * joint.servo.stiffness) > joint.servo.damping:
                what = f"got {joint.servo.damping}; expected at least {least:g}, for the torque lag of {profile}"
                yield TableError(("joints", name, "servo", "damping"), what)


def servos_suit_the_physics_step(stance: Stance) -> Iterator[TableError]:
    """Check that servos are stable in the simulation, whose integration is explicit in their torque."""
    mj, step = stance.model.mj, stance.robot.tables.physics_step
    inverse = np.zeros((mj.nv, mj.nv))
    mujoco.mj_solveM(mj, stance.data, inverse, np.eye(mj.nv))
    for name, joint in stance.robot.tables.joints.items():
        dof = int(mj.joint(name).dofadr[0])
        inertia = 1.0 / float(inverse[dof, dof])
        found = (joint.servo.damping + joint.servo.stiffness * step) * step
        if found > STEP_MARGIN * inertia:
            most = STEP_MARGIN * inertia / step - joint.servo.stiffness * step
            what = (
                f"got {joint.servo.damping}; expected at most {most:.3g}, to move {inertia:.3g} kg·m² by physics_step"
            )
            yield TableError(("joints", name, "servo", "damping"), what)
