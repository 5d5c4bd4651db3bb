"""``robot.yaml``: written for people, every guess with its reason."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import hypot, sqrt

from valor.robot.checks import SIDES
from valor.robot.motion_tables import Footsteps, Walking
from valor.robot.size import ESCHER, narrowness
from valor.robot_setup.drives import DELAY, TORQUE_LAG, Drive
from valor.robot_setup.geometry import Sole
from valor.robot_setup.posture import Stance
from valor.robot_setup.skeleton import Skeleton

WIDE = 0.85  # of a step's greatest length, from which on the width is that of a robot with its feet far apart
HIP_TOLERANCE = 0.01  # of the hip's height, from that which follows from the leg's length, in lengths of the leg
VELOCITY_LAG = 0.0032  # of the estimator's low-pass on joint velocities [s]
SMOOTH = 4.0  # delays that a response takes: Skogestad 2003, smooth control


@dataclass
class Content:
    """All that robot.yaml holds, found or guessed."""

    name: str
    robot: Skeleton
    soles: Mapping[str, Sole]
    drives: Mapping[int, Drive]
    stance: Stance
    mass: float
    arm_presets: Mapping[str, Mapping[str, Mapping[str, float]]]
    pairs: Iterable[tuple[str, str]]
    step: float
    passive: Mapping[str, float]  # where they rest [rad]
    rate: int = 500


def text(content: Content) -> str:
    """The file."""
    return (
        "\n\n".join(
            part
            for part in (_head(content), _joints(content), _postures(content), _motion(content), _frames(content))
            if part
        )
        + "\n"
    )


def _n(value: float) -> str:
    return f"{value:.4g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.2e}"


def _head(content: Content) -> str:
    robot, lines = content.robot, []
    lines += [
        f"# {content.name}: everything the code knows about the robot beside model.xml. Units: m, kg, s, rad, N.",
        f"# Out of {robot.source.file.name}. What was guessed says why; whatever you know better, write it here.",
    ]
    if robot.passive.gone:
        names = ", ".join(robot.joint_name(j) for j in robot.passive.gone)
        lines.append(f"# Welded at zero, because nothing drives them and they are no hinges: {names}.")
    lines += [f"# {note}" for note in robot.source.notes]
    lines += [
        "",
        f"name: {content.name}",
        "model: model.xml",
        f"control_rate: {content.rate}",
        f"physics_step: {content.step:g}",
        f"size: {{ leg: {_n(content.stance.leg_length)}, mass: {_n(content.mass)} }}  # decides what is not said",
        f"base: {robot.name(robot.pelvis)}  # in the middle of the way between the feet",
        f"chest: {robot.name(robot.chest)}  # where the way up from the pelvis branches",
    ]
    if robot.head is not None:
        lines.append(f"head: {robot.name(robot.head)}  # ends what stands on the chest in the middle")
    lines += [
        "imu: { site: imu }  # guessed at the base's origin",
        "",
        "# The largest rectangle in what touches the ground first; the frame is below the ankle.",
    ]
    lines.append("feet:")
    for side in SIDES:
        sole, foot = content.soles[side], robot.name(robot.legs[side].end)
        lines.append(
            f"  {side}: {{ body: {foot}, sole: {side[0]}_sole, heel: {_n(sole.heel)}, toe: {_n(sole.toe)}, "
            f"half_width: {_n(sole.half_width)} }}"
        )
    if robot.arms:
        lines.append("hands:")
        lines += [
            f"  {side}: {{ body: {robot.name(robot.arms[side].end)}, site: {side[0]}_gripper }}" for side in SIDES
        ]
    return "\n".join(lines)


def groups(robot: Skeleton) -> dict[str, list[str]]:
    """Group → joints, in the order of joint vectors."""
    found: dict[str, list[int]] = {f"{side}_leg": robot.legs[side].joints for side in SIDES}
    found["torso"] = robot.waist
    found |= {f"{side}_arm": robot.arms[side].joints if robot.arms else [] for side in SIDES}
    found["neck"] = robot.neck
    found |= {f"{side}_hand": robot.arms[side].beyond if robot.arms else [] for side in SIDES}
    found |= {name if name not in found else f"{name}_others": joints for name, joints in robot.others.items()}
    return {group: [robot.joint_name(j) for j in joints] for group, joints in found.items()}


def _joints(content: Content) -> str:
    by_name = {content.robot.joint_name(j): drive for j, drive in content.drives.items()}
    width = max(len(name) for name in by_name) + 1
    lines = [
        "# The order is that of every joint vector. Servo gains: those of a robot that stands on them, by m·g·h;",
        f"# bounded where a light link, the physics' step or a torque lag of {1e3 * TORQUE_LAG:g} ms made it unstable.",
        "joints:",
    ]
    for members in groups(content.robot).values():
        for name in members:
            d = by_name[name]
            guesses = f"  # guessed: {'; '.join(d.guesses)}" if d.guesses else ""
            lines.append(
                f"  {name + ':':<{width}} {{ lower: {_n(d.lower)}, upper: {_n(d.upper)}, "
                f"velocity: {_n(d.velocity)}, effort: {_n(d.effort)}, control: {d.control}, "
                f"servo: {{ stiffness: {_n(d.stiffness)}, damping: {_n(d.servo_damping)} }}, "
                f"armature: {_n(d.armature)}, damping: {_n(d.damping)} }}{guesses}"
            )
    lines += _passive(content)
    lines += ["", "groups:"]
    lines += [f"  {group}: [{', '.join(members)}]" for group, members in groups(content.robot).items()]
    return "\n".join(lines)


def _passive(content: Content) -> list[str]:
    passive, name = content.robot.passive, content.robot.joint_name
    if not passive.hinges:
        return []
    led = {each.follower: name(each.leader) for each in passive.couplings}
    lines = [
        "",
        "# Nothing drives these. Controllers take them for fixed; simulated, they move as model.xml has them.",
        "passive:",
    ]
    for joint, simulated in passive.hinges.items():
        stiffness = float(content.robot.source.mj.jnt_stiffness[joint])
        why = f"follows {led[joint]}" if joint in led else f"a spring of {stiffness:g} N·m/rad" if stiffness else ""
        why = why or ("held by damping, friction or a loop" if simulated else "nothing holds it")
        moves = str(simulated).lower()
        lines.append(f"  {name(joint)}: {{ at: {_n(content.passive[name(joint)])}, simulated: {moves} }}  # {why}")
    return lines


def _flow(angles: Mapping[str, float]) -> str:
    return "{ " + ", ".join(f"{name}: {_n(angle)}" for name, angle in angles.items()) + " }"


def _postures(content: Content) -> str:
    stance = content.stance
    lines = [
        f"# Solved: hips {stance.hip_height:.3f} m over the ankles, "
        f"{stance.hip_height / stance.leg_length:.0%} of the straight leg;",
        f"# soles level, their middle below the CoM, which is {stance.com_height:.3f} m high.",
        "nominal_posture:",
    ]
    lines += [f"  {name}: {_n(angle)}" for name, angle in stance.angles.items()]
    lines += [f"nominal_base_height: {stance.base_height:.4f}", ""]
    if not content.arm_presets:
        return "\n".join([*lines, "arm_presets: {}"])
    lines += [
        "# Solved: hands in these directions as far as the arm goes there without touching anything.",
        "arm_presets:",
    ]
    for preset, sides in content.arm_presets.items():
        lines.append(f"  {preset}:")
        lines += [f"    {side}: {_flow(sides[side])}" for side in sides]
    return "\n".join(lines)


def _motion(content: Content) -> str:
    weight, stance = content.mass / ESCHER.mass, content.stance
    noise_force = 2.0 * weight
    lines = [
        "actuators:",
        "  ideal: {}",
        "  hardware:  # usual imperfections; forces by the robot's weight",
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
        f"      force: {_n(noise_force)}",
        f"      torque: {_n(0.1 * noise_force)}",
        "",
        "# How it moves follows from its size, but for this.",
        _footsteps(stance),
        "walking:",
        f"  step_width: {_n(stance.width)}  # as it stands",
    ]
    if abs(stance.hip_height / stance.leg_length - Walking().hip_height / ESCHER.leg) > HIP_TOLERANCE:
        lines.append(f"  hip_height: {_n(stance.hip_height)}  # as it stands")
    lines += _limits(content)
    if pairs := list(content.pairs):
        lines += ["self_collision:", "  pairs:", *(f"    - [{a}, {b}]" for a, b in pairs)]
    return "\n".join(lines)


def _limits(content: Content) -> list[str]:
    """Narrow soles rock as fast as ankles may near their stops: what brakes those is no quicker than a drive."""
    if narrowness(content.stance.leg_length, min(sole.half_width for sole in content.soles.values())) >= 1.0:
        return []
    response = 1 / (SMOOTH * (TORQUE_LAG + DELAY + VELOCITY_LAG + 1 / content.rate))
    return [
        "whole_body:",
        f"  limit_response: {_n(response)}  # narrow soles rock: near a stop their ankles brake no quicker than drives",
    ]


def _footsteps(stance: Stance) -> str:
    """Plans of steps are taken; of a robot whose feet are far apart for its size, wider ones than of another."""
    usual, size = Footsteps(), stance.leg_length / ESCHER.leg
    if stance.width <= WIDE * usual.max_distance * size:
        return "footsteps: {}"
    ahead = size * sqrt(usual.max_distance**2 - Walking().step_width ** 2)
    farthest, widest = hypot(stance.width, ahead), max(usual.max_width * size, 1.5 * stance.width)
    return f"footsteps: {{ max_width: {_n(widest)}, max_distance: {_n(farthest)} }}  # as far apart as its feet stand"


def frames(robot: Skeleton) -> dict[str, int | str]:
    """Frame by its REP-120 name, where it has one → body or site."""
    found: dict[str, int | str] = {"base_link": robot.pelvis, "torso": robot.chest, "imu_link": "imu"}
    if robot.head is not None:
        found["head"] = robot.head
    for side, arm in robot.arms.items():
        found |= {f"{side[0]}_wrist": arm.end, f"{side[0]}_gripper": f"{side[0]}_gripper"}
    for side, leg in robot.legs.items():
        found |= {f"{side[0]}_ankle": leg.end, f"{side[0]}_sole": f"{side[0]}_sole"}
    return found


def _frames(content: Content) -> str:
    robot = content.robot
    named = {
        frame: target if isinstance(target, str) else robot.name(target) for frame, target in frames(robot).items()
    }
    return "\n".join(
        ["# REP-120 names where it has them.", "link_frames:", *(f"  {frame}: {name}" for frame, name in named.items())]
    )
