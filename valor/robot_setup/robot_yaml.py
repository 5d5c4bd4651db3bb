"""``robot.yaml``: written for people, every guess with its reason."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from valor.robot_setup.drives import TORQUE_LAG, Drive
from valor.robot_setup.geometry import Sole
from valor.robot_setup.posture import SIDES, Stance
from valor.robot_setup.skeleton import Skeleton

ESCHER_LEG, ESCHER_MASS = 0.82, 75.9  # [m], [kg]: the defaults of controllers are this robot's

# Section → key → ESCHER's value and its dimension: l: length; t: time; v, w: speed and turn rate; a: per time; aa: per
# time squared; f: force. Robots of another size get them as one that falls as it does, seen in its own time (Froude).
SCALED: Mapping[str, Mapping[str, tuple[float, str]]] = {
    "walking": {
        "swing_duration": (0.6, "t"),
        "transfer_duration": (0.2, "t"),
        "fast_swing_duration": (0.42, "t"),
        "fast_transfer_duration": (0.06, "t"),
        "full_speed": (0.7, "v"),
        "first_transfer_duration": (1.0, "t"),
        "last_transfer_duration": (1.0, "t"),
        "swing_height": (0.06, "l"),
        "plan_swing_height": (0.08, "l"),
        "touchdown_depth": (0.025, "l"),
        "touchdown_force": (30.0, "f"),
        "descent": (0.2, "v"),
        "late_descent": (0.4, "v"),
        "latest_touchdown": (0.3, "t"),
        "loading_duration": (0.05, "t"),
        "foot_stiffness": (300.0, "aa"),
        "foot_damping": (34.0, "a"),
        "max_forward_speed": (1.2, "v"),
        "max_backward_speed": (0.3, "v"),
        "max_lateral_speed": (0.125, "v"),
        "max_turn_rate": (0.4, "a"),
        "speed_change": (0.12, "v"),
        "turn_change": (0.2, "a"),
    },
    "pelvis": {
        "max_shift": (0.05, "l"),
        "max_up": (0.03, "l"),
        "max_down": (0.13, "l"),
        "max_speed": (0.15, "v"),
        "max_turn_rate": (0.4, "a"),
        "max_turn_acceleration": (1.5, "aa"),
    },
    "whole_body": {
        "contact_inset": (0.005, "l"),
        "dcm_push_error": (0.02, "l"),
        "orientation_stiffness": (120.0, "aa"),
        "orientation_damping": (22.0, "a"),
        "foot_damping": (10.0, "a"),
        "stance_stiffness": (100.0, "aa"),
        "posture_stiffness": (60.0, "aa"),
        "posture_damping": (14.0, "a"),
        "dcm_integral_limit": (0.1, "l"),
        "dcm_integral_error": (0.01, "l"),
        "com_shift_limit": (0.05, "l"),
    },
    "disturbance": {
        "plan_reach": (0.05, "l"),
        "threshold": (0.025, "l"),
        "final": (0.06, "t"),
        "shortest_swing": (0.25, "t"),
        "longest_delay": (0.15, "t"),
        "foot_speed": (3.0, "v"),
        "clearance": (0.01, "l"),
        "max_width": (0.6, "l"),
        "max_backward": (0.5, "l"),
        "diagonal_width": (0.3, "l"),
        "giving": (0.04, "l"),
        "calm": (0.04, "l"),
        "recovery_transfer_duration": (0.05, "t"),
        "recovery_swing_duration": (0.3, "t"),
        "recovery_swing_height": (0.04, "l"),
    },
    "hand_goals": {"max_speed": (0.25, "v")},
    "footsteps": {
        "max_forward": (0.6, "l"),
        "max_backward": (0.3, "l"),
        "max_width": (0.6, "l"),
        "max_distance": (0.4, "l"),
        "max_up": (0.25, "l"),
        "max_down": (0.2, "l"),
        "max_swing_height": (0.2, "l"),
        "min_swing_duration": (0.4, "t"),
        "max_swing_duration": (3.0, "t"),
        "min_transfer_duration": (0.1, "t"),
        "max_transfer_duration": (3.0, "t"),
    },
}


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


def _size(content: Content) -> float:
    return content.stance.leg_length / ESCHER_LEG


def _n(value: float) -> str:
    return f"{value:.4g}" if abs(value) >= 1e-3 or value == 0 else f"{value:.2e}"


def _head(content: Content) -> str:
    robot, lines = content.robot, []
    lines += [
        f"# {content.name}: everything the code knows about the robot beside model.xml. Units: m, kg, s, rad, N.",
        f"# Out of {robot.source.file.name}. What was guessed says why; whatever you know better, write it here.",
    ]
    if robot.passive:
        names = ", ".join(robot.joint_name(j) for j in robot.passive)
        lines.append(f"# Welded at zero, because nothing drives them or they follow others: {names}.")
    lines += [f"# {note}" for note in robot.source.notes]
    lines += [
        "",
        f"name: {content.name}",
        "model: model.xml",
        f"control_rate: {content.rate}",
        f"physics_step: {content.step:g}",
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
        on, off = (force * content.mass / ESCHER_MASS for force in (15.0, 8.0))
        lines.append("hands:")
        lines += [
            f"  {side}: {{ body: {robot.name(robot.arms[side].end)}, site: {side[0]}_gripper }}" for side in SIDES
        ]
        lines.append(f"  contact_on: {_n(on)}  # by the robot's weight")
        lines.append(f"  contact_off: {_n(off)}")
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
    lines += ["", "groups:"]
    lines += [f"  {group}: [{', '.join(members)}]" for group, members in groups(content.robot).items()]
    return "\n".join(lines)


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
    size, weight = _size(content), content.mass / ESCHER_MASS
    factor = {"l": size, "t": size**0.5, "v": size**0.5, "w": size**-0.5, "a": size**-0.5, "aa": 1 / size, "f": weight}
    half_width = min(sole.half_width for sole in content.soles.values())
    stance = content.stance
    own: dict[str, dict[str, float]] = {
        "walking": {"step_width": stance.width, "hip_height": stance.hip_height, "leg_reach": 0.94 * stance.leg_length},
        "pelvis": {"com_margin": min(0.05 * size, 0.6 * half_width)},
        "whole_body": {},
        "disturbance": {"edge_margin": 0.4 * half_width},
        "footsteps": {"max_steps": 50, "min_width": 2.02 * half_width, "max_yaw": 0.6, "max_tilt": 0.35},
    }
    noise_force = 2.0 * weight
    lines = [
        "actuators:",
        "  ideal: {}",
        "  hardware:  # usual imperfections",
        "    mass_error: 0.05",
        f"    friction: {_n(2.0 * weight)}  # by the robot's weight",
        f"    torque_lag: {TORQUE_LAG:g}",
        "    delay: 0.004",
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
        "fall:",
        "  tilt: 0.6",
        "  height: 0.75",
        f"  dcm_margin: {_n(0.4 * half_width)}",
        f"  dcm_margin_stepping: {_n(0.1 * size)}",
        "",
        f"# ESCHER's, for a leg {size:.2f} times as long: lengths by it, times and speeds by its root.",
    ]
    for section, keys in SCALED.items():
        lines.append(f"{section}:")
        values = own.get(section, {}) | {key: value * factor[kind] for key, (value, kind) in keys.items()}
        lines += [f"  {key}: {_n(value)}" for key, value in values.items()]
    lines += ["self_collision:", f"  distance: {_n(0.02 * size)}", f"  near: {_n(0.045 * size)}"]
    pairs = list(content.pairs)
    lines += ["  pairs:", *(f"    - [{a}, {b}]" for a, b in pairs)] if pairs else []
    return "\n".join(lines)


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
