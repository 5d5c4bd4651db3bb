"""Generation of ``robot.yaml``, with a comment on every guess."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, sqrt
from pathlib import Path

import mujoco

from valor.robot.motion_tables import Footsteps, Walking
from valor.robot.size import ESCHER, narrowness
from valor.robot.tables import SIDES
from valor.robot_setup import model_xml
from valor.robot_setup.drives import DELAY, TORQUE_LAG, Drive
from valor.robot_setup.geometry import ModelGeometry
from valor.robot_setup.posture import Stance
from valor.robot_setup.skeleton import Skeleton

CONTROL_RATE = 500  # [Hz]
WIDE = 0.85  # minimum width of a wide stance, relative to the greatest length of a step
HIP_TOLERANCE = 0.01  # deviation of hip height from its default, relative to the leg's length
VELOCITY_LAG = 0.0032  # of the estimator's low-pass on joint velocities [s]
SMOOTH = 4.0  # time constant of a response in delays: Skogestad 2003, smooth control


@dataclass
class RobotDraft:
    """Content of a robot's folder, found or guessed."""

    name: str
    robot: Skeleton
    geometry: ModelGeometry
    drives: Mapping[int, Drive]  # by joint
    stance: Stance
    mass: float  # [kg]
    arm_presets: Mapping[str, Mapping[str, Mapping[str, float]]]  # preset, side, joint → angle [rad]
    pairs: list[tuple[str, str]]  # bodies kept apart
    passive: Mapping[str, float]  # passive joint → angle at rest [rad]

    def write(self, folder: Path) -> None:
        """Write ``model.xml``, ``robot.yaml`` and meshes to an existing folder."""
        model_xml.write(self.robot, self.geometry, self.name, folder, self.stance.leg_length)
        (folder / "robot.yaml").write_text(render(self), encoding="utf-8")


def render(draft: RobotDraft) -> str:
    """Return the text of robot.yaml."""
    sections = (_head, _joints, _postures, _motion, _frames)
    return "\n\n".join("\n".join(section(draft)) for section in sections) + "\n"


def _n(value: float) -> str:
    return f"{value:.4g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.2e}"


def _head(draft: RobotDraft) -> list[str]:
    robot, stance = draft.robot, draft.stance
    lines = [
        f"# {draft.name}: all parameters of the robot except model.xml. Units: m, kg, s, rad, N.",
        f"# Generated from {robot.source.file.name}. Guesses state their reason; replace them with measured values.",
    ]
    if robot.passive.unsupported:
        names = ", ".join(robot.joint_names(robot.passive.unsupported))
        lines.append(f"# Welded at zero, because they have no drive and are not hinges: {names}.")
    lines += [f"# {note}" for note in robot.source.notes]
    lines += [
        "",
        f"name: {draft.name}",
        "model: model.xml",
        f"control_rate: {CONTROL_RATE}",
        f"physics_step: {draft.geometry.step:g}",
        f"size: {{ leg: {_n(stance.leg_length)}, mass: {_n(draft.mass)} }}  # scales the defaults of omitted keys",
        f"base: {robot.name(robot.pelvis)}  # in the middle of the path between the feet",
        f"chest: {robot.name(robot.chest)}  # where the path up from the pelvis branches",
    ]
    if robot.head is not None:
        lines.append(f"head: {robot.name(robot.head)}  # at the end of the chest's branch in the middle plane")
    lines += [
        f"imu: {{ site: imu{_without_accelerometer(robot)} }}  # guessed at the base's origin",
        "",
        "# The largest rectangle in the part that touches the ground first; the frame is below the ankle.",
        "feet:",
    ]
    for side in SIDES:
        sole, foot = draft.geometry.soles[side], robot.name(robot.legs[side].end)
        lines.append(
            f"  {side}: {{ body: {foot}, sole: {side[0]}_sole, heel: {_n(sole.heel)}, toe: {_n(sole.toe)}, "
            f"half_width: {_n(sole.half_width)} }}"
        )
    if robot.arms:
        lines.append("hands:")
        lines += [
            f"  {side}: {{ body: {robot.name(robot.arms[side].end)}, site: {side[0]}_gripper }}" for side in SIDES
        ]
    return lines


def _without_accelerometer(robot: Skeleton) -> str:
    """Return the key of an IMU for which the model lists a gyroscope, but no accelerometer."""
    sensors, kinds = set(robot.source.mj.sensor_type.tolist()), mujoco.mjtSensor
    return (
        ", accelerometer: false" if int(kinds.mjSENS_ACCELEROMETER) not in sensors >= {int(kinds.mjSENS_GYRO)} else ""
    )


def groups(robot: Skeleton) -> dict[str, list[str]]:
    """Return group → joints, in the order of joint vectors."""
    found: dict[str, list[int]] = {f"{side}_leg": robot.legs[side].joints for side in SIDES}
    found["torso"] = robot.waist
    found |= {f"{side}_arm": robot.arms[side].joints if robot.arms else [] for side in SIDES}
    found["neck"] = robot.neck
    found |= {f"{side}_hand": robot.arms[side].fingers if robot.arms else [] for side in SIDES}
    found |= {name if name not in found else f"{name}_others": joints for name, joints in robot.others.items()}
    return {group: list(robot.joint_names(joints)) for group, joints in found.items()}


def _joints(draft: RobotDraft) -> list[str]:
    by_name = {draft.robot.joint_name(j): drive for j, drive in draft.drives.items()}
    width = max(len(name) for name in by_name) + 1
    lines = [
        "# In the order of every joint vector. Servo gains suffice to stand on the servos (in terms of m·g·h);",
        f"# bounds keep light links stable with the physics step and a torque lag of {1e3 * TORQUE_LAG:g} ms.",
        "joints:",
    ]
    for members in groups(draft.robot).values():
        for name in members:
            d = by_name[name]
            guesses = f"  # guessed: {'; '.join(d.guesses)}" if d.guesses else ""
            lines.append(
                f"  {name + ':':<{width}} {{ lower: {_n(d.lower)}, upper: {_n(d.upper)}, "
                f"velocity: {_n(d.velocity)}, effort: {_n(d.effort)}, control: {d.control}, "
                f"servo: {{ stiffness: {_n(d.stiffness)}, damping: {_n(d.servo_damping)} }}, "
                f"armature: {_n(d.armature)}, damping: {_n(d.damping)} }}{guesses}"
            )
    lines += [*_passive(draft), "", "groups:"]
    return lines + [f"  {group}: [{', '.join(members)}]" for group, members in groups(draft.robot).items()]


def _passive(draft: RobotDraft) -> list[str]:
    passive, name = draft.robot.passive, draft.robot.joint_name
    if not passive.hinges:
        return []
    leaders = {each.follower: name(each.leader) for each in passive.couplings}
    lines = [
        "",
        "# Joints without a drive. Controllers treat them as fixed; in simulation they move as in model.xml.",
        "passive:",
    ]
    for joint, simulated in passive.hinges.items():
        stiffness = float(draft.robot.source.mj.jnt_stiffness[joint])
        if joint in leaders:
            reason = f"follows {leaders[joint]}"
        elif stiffness:
            reason = f"a spring of {stiffness:g} N·m/rad"
        else:
            reason = "held by damping, friction or a loop" if simulated else "no spring, damping, friction or loop"
        angle, moves = _n(draft.passive[name(joint)]), str(simulated).lower()
        lines.append(f"  {name(joint)}: {{ at: {angle}, simulated: {moves} }}  # {reason}")
    return lines


def _postures(draft: RobotDraft) -> list[str]:
    stance = draft.stance
    lines = [
        f"# Solved: hips {stance.hip_height:.3f} m over the ankles, "
        f"{stance.hip_height / stance.leg_length:.0%} of the straight leg;",
        f"# soles level, their middle below the CoM, which is {stance.com_height:.3f} m high.",
        "nominal_posture:",
        *(f"  {name}: {_n(angle)}" for name, angle in stance.angles.items()),
        f"nominal_base_height: {stance.base_height:.4f}",
        "",
    ]
    if not draft.arm_presets:
        return [*lines, "arm_presets: {}"]
    lines += ["# Solved: hands as far in these directions as the arms reach without contact.", "arm_presets:"]
    for preset, sides in draft.arm_presets.items():
        lines.append(f"  {preset}:")
        for side, posture in sides.items():
            lines.append(f"    {side}: {{ {', '.join(f'{name}: {_n(angle)}' for name, angle in posture.items())} }}")
    return lines


def _motion(draft: RobotDraft) -> list[str]:
    weight, stance = draft.mass / ESCHER.mass, draft.stance
    lines = [
        "actuators:",
        "  ideal: {}",
        "  hardware:  # usual imperfections; forces in proportion to the robot's weight",
        "    mass_error: 0.05",
        f"    friction: {_n(2.0 * weight)}",
        f"    torque_lag: {TORQUE_LAG:g}",
        f"    delay: {DELAY:g}",
        "    noise:",
        "      joint_position: 0.0002",
        "      joint_position_resolution: 0.00005",
        "      joint_velocity: 0.02",
        f"      joint_effort: {_n(0.5 * weight)}",
        "      orientation: 0.002",
        "      orientation_bias: 0.002",
        "      gyroscope: 0.005",
        "      accelerometer: 0.05",
        f"      force: {_n(2.0 * weight)}",
        f"      torque: {_n(0.2 * weight)}",
        "",
        "# Other parameters of motion follow from the robot's size.",
        _footsteps(stance),
        "walking:",
        f"  step_width: {_n(stance.step_width)}  # between legs that do not lean",
    ]
    if abs(stance.hip_height / stance.leg_length - Walking().hip_height / ESCHER.leg) > HIP_TOLERANCE:
        lines.append(f"  hip_height: {_n(stance.hip_height)}  # as in the nominal posture")
    speed = _lateral_speed(stance)
    if speed < Walking().max_lateral_speed * sqrt(stance.leg_length / ESCHER.leg):
        lines.append(f"  max_lateral_speed: {_n(speed)}  # wider steps exceed footsteps.max_width")
    if narrowness(stance.leg_length, min(sole.half_width for sole in draft.geometry.soles.values())) < 1.0:
        response = 1 / (SMOOTH * (TORQUE_LAG + DELAY + VELOCITY_LAG + 1 / CONTROL_RATE))
        reason = "narrow soles tilt until ankles are near a limit; braking there must not be faster than the drives"
        lines += ["whole_body:", f"  limit_response: {_n(response)}  # {reason}"]
    if draft.pairs:
        lines += ["self_collision:", "  pairs:", *(f"    - [{a}, {b}]" for a, b in draft.pairs)]
    return lines


def _footsteps(stance: Stance) -> str:
    """Accept plans of steps; wider ones for a robot whose feet are far apart for its size."""
    usual, size = Footsteps(), stance.leg_length / ESCHER.leg
    if not _is_wide(stance) and stance.width == stance.step_width:
        return "footsteps: {}"
    ahead = size * sqrt(usual.max_distance**2 - Walking().step_width ** 2)
    widest, farthest = _widest(stance), hypot(stance.width, ahead)
    return f"footsteps: {{ max_width: {_n(widest)}, max_distance: {_n(farthest)} }}  # the stance is wide"


def _is_wide(stance: Stance) -> bool:
    return stance.step_width > WIDE * Footsteps().max_distance * stance.leg_length / ESCHER.leg


def _widest(stance: Stance) -> float:
    """Return the largest distance of the feet in a step [m]."""
    usual = Footsteps().max_width * stance.leg_length / ESCHER.leg
    return max(usual, 1.5 * stance.step_width) if _is_wide(stance) else usual


def _lateral_speed(stance: Stance) -> float:
    """Return the speed at which steps aside reach ``footsteps.max_width`` [m/s]: one of two makes the way of both."""
    walking, slower = Walking(), sqrt(stance.leg_length / ESCHER.leg)
    period = slower * (walking.fast_swing_duration + walking.fast_transfer_duration)
    return 0.5 * (_widest(stance) - stance.step_width) / period


def frames(robot: Skeleton) -> dict[str, int | str]:
    """Return frame → body or site; REP-120 names where there is one."""
    found: dict[str, int | str] = {"base_link": robot.pelvis, "torso": robot.chest, "imu_link": "imu"}
    if robot.head is not None:
        found["head"] = robot.head
    for side, arm in robot.arms.items():
        found |= {f"{side[0]}_wrist": arm.end, f"{side[0]}_gripper": f"{side[0]}_gripper"}
    for side, leg in robot.legs.items():
        found |= {f"{side[0]}_ankle": leg.end, f"{side[0]}_sole": f"{side[0]}_sole"}
    return found


def _frames(draft: RobotDraft) -> list[str]:
    robot = draft.robot
    lines = ["# REP-120 names where there is one.", "link_frames:"]
    for frame, target in frames(robot).items():
        lines.append(f"  {frame}: {target if isinstance(target, str) else robot.name(target)}")
    return lines
