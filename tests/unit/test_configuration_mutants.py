"""Configurations that cannot be right: each is one line with file, line and key, before anything starts."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.places import ROBOTS
from valor.common import resources
from valor.common.errors import ConfigurationError, SeveralFaultsError
from valor.valorctl import instance_setup
from valor.valorctl.instance_setup import Request
from valor.valorctl.profile import Profile
from valor.valorctl.robot_check import require_sound

ESCHER = ROBOTS / "escher"
BOMB = "bomb0: &b0 [x, x, x, x, x, x, x, x]\n" + "".join(
    f"bomb{i}: &b{i} [*b{i - 1}, *b{i - 1}, *b{i - 1}, *b{i - 1}, *b{i - 1}, *b{i - 1}]\n" for i in range(1, 12)
)
LEFT_LEG, RIGHT_LEG = (
    f"{side}_hip_yaw, {side}_hip_roll, {side}_hip_pitch, {side}_knee_pitch, {side}_ankle_pitch, {side}_ankle_roll"
    for side in "lr"
)


class Mutant(NamedTuple):
    """A file that was changed, and what is said of it."""

    change: tuple[str, str] | tuple[tuple[str, str], ...]
    key: str  # the line that is named has its last part, unless that is a place in a list
    told: str = ""


def swap(one: str, other: str) -> tuple[tuple[str, str], ...]:
    """Two texts in each other's place."""
    return ((one, "\0"), (other, one), ("\0", other))


def joint(name: str, old: str, new: str) -> tuple[str, str]:
    """A change in the line of a joint."""
    line = next(line for line in (ESCHER / "robot.yaml").read_text().splitlines() if line.startswith(f"  {name}: "))
    assert old in line
    return line, line.replace(old, new)


def added(text: str) -> tuple[str, str]:
    """A text at the file's end."""
    return "  r_toe: r_toe\n", f"  r_toe: r_toe\n{text}"


KNEE = "l_knee_pitch"
ROBOT: dict[str, Mutant] = {
    # Sides, limbs, groups.
    "the right sole on the left foot": Mutant(("l_foot, sole: l_sole", "l_foot, sole: r_sole"), "feet.right.sole"),
    "a hand's site as a sole": Mutant(("sole: l_sole,", "sole: l_gripper,"), "feet.left.sole", "on l_hand"),
    "both feet left": Mutant(("body: r_foot, sole: r_sole", "body: l_foot, sole: l_sole"), "feet.right.body"),
    "heel and toe swapped": Mutant(
        ("heel: -0.10, toe: 0.15", "heel: 0.15, toe: -0.10"), "feet.left.heel", "less than toe"
    ),
    "heel and toe mirrored": Mutant(
        ("heel: -0.10, toe: 0.15", "heel: -0.15, toe: 0.10"), "feet.left.heel", "expected -0.100"
    ),
    "a sole 1 m wide": Mutant(("0.07425", "0.5"), "feet.left.half_width", "expected 0.074"),
    "a sole 1 m long": Mutant(("toe: 0.15", "toe: 0.9"), "feet.left.toe", "expected 0.150"),
    "a sole without width": Mutant(("0.07425", "0"), "feet.left.half_width", "> 0"),
    "a narrow sole": Mutant(("0.07425", "0.02"), "feet.left.half_width"),
    "feet swapped": Mutant(swap("l_foot, sole: l_sole", "r_foot, sole: r_sole"), "feet.left.body", "other side"),
    "hands swapped": Mutant(
        swap("l_hand, site: l_gripper", "r_hand, site: r_gripper"), "hands.left.body", "other side"
    ),
    "both hands right": Mutant(("l_hand, site: l_gripper", "r_hand, site: r_gripper"), "hands.right.body"),
    "legs swapped": Mutant(swap(LEFT_LEG, RIGHT_LEG), "groups.left_leg", "expected l_hip_yaw"),
    "arms swapped": Mutant(swap("left_arm: [", "right_arm: ["), "arm_presets.home.left.l_shoulder_pitch"),
    "fingers swapped": Mutant(swap("left_hand: [", "right_hand: ["), "hand_presets.open.left.l_index_yaw"),
    "a joint in both legs": Mutant(
        ("r_ankle_pitch, r_ankle_roll]", "r_ankle_pitch, l_ankle_roll]"), "groups.right_leg.5"
    ),
    "a joint twice in a group": Mutant(("[neck_yaw,", "[neck_yaw, neck_yaw,"), "groups.neck.1"),
    "a joint in no group": Mutant(
        ("l_hip_pitch, l_knee_pitch, ", "l_hip_pitch, "), "joints.l_knee_pitch", "in no group"
    ),
    "a group missing": Mutant(("  neck: [neck_yaw, neck_pitch]\n", ""), "joints.neck_yaw", "in no group"),
    "a leg's group missing": Mutant((f"  left_leg: [{LEFT_LEG}]\n", ""), "groups.left_leg", "missing"),
    "a group misspelt": Mutant(("  torso: [waist_yaw]", "  trunk: [waist_yaw]"), "groups.torso", "missing"),
    "a group with an unknown joint": Mutant(("[neck_yaw,", "[neck,"), "groups.neck.0", "got 'neck'"),
    "the waist in an arm": Mutant(
        (("torso: [waist_yaw]", "torso: []"), ("left_arm: [", "left_arm: [waist_yaw, ")), "devices.legs", "waist_yaw"
    ),
    "the lidar in a hand": Mutant(
        (
            ("lidar: [lidar_roll]", "lidar: []"),
            ("left_hand: [", "left_hand: [lidar_roll, "),
            ("      - { id: 3, joint: lidar_roll, model: XM430-W350, firmware: 46, zero: 2048, spin: 1.0 }\n", ""),
        ),
        "groups.left_hand.0",
        "beyond l_hand",
    ),
    "another chest": Mutant(("chest: chest\n", "chest: l_foot\n"), "groups.torso", "expected"),
    "another base": Mutant(("base: pelvis", "base: chest"), "base", "pelvis"),
    "no such head": Mutant(("head: head\n", "head: skull\n"), "head", "got 'skull'"),
    "the IMU on a foot": Mutant(("imu: { site: imu }", "imu: { site: l_sole }"), "imu.site", "on l_foot"),
    "no such frame": Mutant(("  l_ankle: l_foot", "  l_ankle: l_tail"), "link_frames.l_ankle", "l_tail"),
    # Keys and values.
    "footsteps twice": Mutant(added("footsteps: { max_up: 0.2 }\n"), "footsteps", "stands twice, in line"),
    "control_rate twice": Mutant(added("control_rate: 250\n"), "control_rate", "stands twice"),
    "effort twice": Mutant(
        joint(KNEE, "effort: 300", "effort: 300, effort: 3000"), "joints.l_knee_pitch.effort", "twice"
    ),
    "a joint twice": Mutant(("groups:\n", "  l_hip_yaw: {}\ngroups:\n"), "joints.l_hip_yaw", "stands twice"),
    "octal": Mutant(joint(KNEE, "effort: 300", "effort: 0300"), "joints.l_knee_pitch.effort", "got 0300"),
    "sexagesimal": Mutant(joint(KNEE, "effort: 300", "effort: 5:00"), "joints.l_knee_pitch.effort", "got 5:00"),
    "underscores": Mutant(joint(KNEE, "effort: 300", "effort: 3_00"), "joints.l_knee_pitch.effort", "got 3_00"),
    "yes": Mutant(joint(KNEE, "control: force", "control: yes"), "joints.l_knee_pitch.control", "got yes"),
    "a number in quotes": Mutant(
        joint(KNEE, "effort: 300", "effort: '300'"), "joints.l_knee_pitch.effort", "got '300'"
    ),
    "a truth for a number": Mutant(
        joint(KNEE, "effort: 300", "effort: true"), "joints.l_knee_pitch.effort", "got True"
    ),
    "not a number": Mutant(joint(KNEE, "effort: 300", "effort: .nan"), "joints.l_knee_pitch.effort", "got nan"),
    "infinite": Mutant(joint(KNEE, "effort: 300", "effort: .inf"), "joints.l_knee_pitch.effort", "got inf"),
    "too large for a float": Mutant(joint(KNEE, "effort: 300", "effort: 1e999"), "joints.l_knee_pitch.effort", "inf"),
    "nothing": Mutant(joint(KNEE, "effort: 300", "effort: ~"), "joints.l_knee_pitch.effort", "got nothing"),
    "a missing key": Mutant(joint(KNEE, "effort: 300, ", ""), "joints.l_knee_pitch.effort", "missing"),
    "a misspelt key": Mutant(joint(KNEE, "effort:", "efort:"), "joints.l_knee_pitch.efort", "did you mean 'effort'?"),
    "another control": Mutant(
        joint(KNEE, "control: force", "control: torque"), "joints.l_knee_pitch.control", "torque"
    ),
    "a list for a mapping": Mutant(("hand_presets:\n", "hand_goals: []\nhand_presets:\n"), "hand_goals", "got a list"),
    "a tag": Mutant(("name: escher", "name: !!python/name:os.system escher"), "name", "the tag"),
    "two documents": Mutant(added("---\nname: other\n"), "(whole file)", "second document"),
    "a number as a key": Mutant(added("1: 2\n"), "(whole file)", "got the key 1"),
    "a bomb of aliases": Mutant(added(BOMB), "", "once aliases are put in"),
    "a bomb of brackets": Mutant(added(f"deep: {'[' * 5000}\n"), f"deep{'.0' * 16}", "in each other"),
    "an unknown alias": Mutant(("gears: &hdt_gears", "gears: *hdt_gear"), "actuators.hdt_arms.gears", "anchors"),
    # Limits and postures.
    "limits the wrong way round": Mutant(
        joint(KNEE, "lower: 0,", "lower: 3,"), "joints.l_knee_pitch.lower", "less than upper"
    ),
    "half a limit": Mutant(joint(KNEE, "lower: 0, ", ""), "joints.l_knee_pitch", "both lower and upper"),
    "limits in degrees": Mutant(joint(KNEE, "upper: 2.356", "upper: 135"), "joints.l_knee_pitch.upper", "got 135"),
    "limits of the other sign": Mutant(
        joint(KNEE, "lower: 0, upper: 2.356", "lower: -2.356, upper: 0"), "nominal_posture.l_knee_pitch", "-2.356 to 0"
    ),
    "no effort": Mutant(joint(KNEE, "effort: 300", "effort: 0"), "joints.l_knee_pitch.effort", "> 0"),
    "negative effort": Mutant(joint(KNEE, "effort: 300", "effort: -300"), "joints.l_knee_pitch.effort", "> 0"),
    "negative velocity": Mutant(joint(KNEE, "velocity: 12", "velocity: -12"), "joints.l_knee_pitch.velocity", "> 0"),
    "too little effort to stand": Mutant(joint(KNEE, "effort: 300", "effort: 30"), "joints.l_knee_pitch.effort", "N·m"),
    "ankles too soft to stand": Mutant(
        (joint("l_ankle_pitch", "1500", "200"), joint("r_ankle_pitch", "1500", "200")),
        "joints.l_ankle_pitch.servo.stiffness",
        "falls in Stand Prep",
    ),
    "a servo that oscillates": Mutant(
        joint(KNEE, "stiffness: 2000, damping: 100", "stiffness: 2000, damping: 1"), "joints.l_knee_pitch.servo.damping"
    ),
    "a knee at 3 rad": Mutant(
        ("  l_knee_pitch: 0.9719", "  l_knee_pitch: 3"), "nominal_posture.l_knee_pitch", "0.0 to 2.356"
    ),
    "a base 1.6 m high": Mutant(("height: 0.8050", "height: 1.6"), "nominal_base_height", "expected 0.8050"),
    "a base in centimetres": Mutant(("height: 0.8050", "height: 80.5"), "nominal_base_height", "expected 0.8050"),
    "one knee straight": Mutant(("  l_knee_pitch: 0.9719", "  l_knee_pitch: 0.1"), "nominal_posture"),
    "feet that tilt": Mutant(("  l_ankle_pitch: -0.5026", "  l_ankle_pitch: -0.4"), "nominal_posture", "tilts l_sole"),
    "leaning over the toes": Mutant(
        (
            *((f"  {side}_hip_pitch: -0.4693", f"  {side}_hip_pitch: -0.25") for side in "lr"),
            *((f"  {side}_ankle_pitch: -0.5026", f"  {side}_ankle_pitch: -0.7219") for side in "lr"),
            ("height: 0.8050", "height: 0.785"),
        ),
        "nominal_posture",
        "CoM -0.003 m inside",
    ),
    "an unknown joint in the posture": Mutant(
        ("  l_elbow_pitch: 0.5\n", "  l_elbow: 0.5\n"), "nominal_posture.l_elbow"
    ),
    "arms in the chest": Mutant(
        (
            ("  l_shoulder_roll: 0.2\n", "  l_shoulder_roll: -0.5\n"),
            ("  l_elbow_pitch: 0.5\n", "  l_elbow_pitch: 2.4\n"),
        ),
        "nominal_posture",
        "touches",
    ),
    "a preset outside limits": Mutant(
        ("left: { l_shoulder_pitch: -2.5,", "left: { l_shoulder_pitch: -25,"), "arm_presets.up.left.l_shoulder_pitch"
    ),
    "a preset of the other side": Mutant(
        ("left: { l_index_yaw: 0.3,", "left: { r_index_yaw: 0.3,"), "hand_presets.open.left.r_index_yaw"
    ),
    "a preset of a third side": Mutant(
        ("    left: { l_index_", "    up: { l_index_"), "hand_presets.open", "left or right"
    ),
    # Size, periods, thresholds, motion.
    "no size": Mutant(("size: { leg: 0.82, mass: 75.9 }\n", ""), "size", "missing"),
    "a leg in millimetres": Mutant(("leg: 0.82", "leg: 820"), "size.leg", "<= 3.0 m, got 820"),
    "another leg": Mutant(("leg: 0.82", "leg: 0.9"), "size.leg", "expected 0.82"),
    "no leg": Mutant(("leg: 0.82", "leg: 0"), "size.leg", "> 0"),
    "a mass in pounds": Mutant(("mass: 75.9", "mass: 167"), "size.mass", "expected 75.9"),
    "7 Hz": Mutant(("control_rate: 500", "control_rate: 7"), "control_rate", "got 7"),
    "periods of no whole steps": Mutant(
        ("physics_step: 0.001", "physics_step: 0.0015"), "physics_step", "whole number"
    ),
    "a step of a second": Mutant(("physics_step: 0.001", "physics_step: 1"), "physics_step"),
    "a tilt in degrees": Mutant(added("fall: { tilt: 35 }\n"), "fall.tilt", "got 35"),
    "always fallen": Mutant(added("fall: { height: 1.2 }\n"), "fall.height"),
    "never out of balance": Mutant(added("fall: { dcm_margin: 30 }\n"), "fall.dcm_margin", "<= 0.3 m, got 30"),
    "legs longer than they are": Mutant(added("walking: { leg_reach: 0.9 }\n"), "walking.leg_reach", "straight leg"),
    "hips higher than legs reach": Mutant(added("walking: { hip_height: 0.9 }\n"), "walking.leg_reach", "hip_height"),
    "hips lower than they are": Mutant(added("walking: { hip_height: 0.5 }\n"), "walking.hip_height", "expected 0.725"),
    "feet in one line": Mutant(added("walking: { step_width: 0.05 }\n"), "walking.step_width", "as footsteps says"),
    "feet on each other": Mutant(
        ("footsteps: {}", "footsteps: { min_width: 0.05 }"), "footsteps.min_width", "soles touch"
    ),
    "the least above the most": Mutant(
        ("footsteps: {}", "footsteps: { min_width: 1.5 }"), "footsteps.min_width", "less than max_width"
    ),
    "gains the wrong way round": Mutant(added("gains: { min_stiffness: 2 }\n"), "gains.min_stiffness", "less than max"),
    "contacts the wrong way round": Mutant(added("estimator: { contact_off: 0.5 }\n"), "estimator.contact_off"),
    "a pair of one": Mutant(("[l_foot, r_foot]", "[l_foot, l_foot]"), "self_collision.pairs.0"),
    "a pair with nobody": Mutant(("[l_foot, r_foot]", "[l_foot, r_tail]"), "self_collision.pairs.0", "r_tail"),
    "a pair with too many": Mutant(("[l_foot, r_foot]", "[l_foot, r_foot, head]"), "self_collision.pairs.0"),
    "kept farther apart than they are": Mutant(
        ("self_collision:\n", "self_collision:\n  distance: 0.06\n  near: 0.1\n"), "self_collision.distance", "0.05"
    ),
    # Actuators and devices.
    "masses below zero": Mutant(("mass_error: 0.05", "mass_error: 1.5"), "actuators.hardware.mass_error"),
    "a delay in milliseconds": Mutant(("delay: 0.004", "delay: 4"), "actuators.hardware.delay"),
    "gears of nobody": Mutant(("left_arm: &hdt", "left_wing: &hdt"), "actuators.hdt_arms.gears.left_wing"),
    "no such device": Mutant(("kind: ft_can", "kind: ft_can_fd"), "devices.force_torque.kind", "got 'ft_can_fd'"),
    "two with one id": Mutant(
        ("{ id: 2, at: right_foot", "{ id: 1, at: right_foot"), "devices.force_torque.sensors.1.id"
    ),
    "two at one place": Mutant(("at: right_foot", "at: left_foot"), "devices.force_torque.sensors.1.at"),
    "a joint on two drives": Mutant(("axes: [waist_yaw]", "axes: [l_hip_yaw]"), "devices.legs", "moves already"),
    "a drive without a joint": Mutant(("axes: [waist_yaw]", "axes: [tail_yaw]"), "devices.legs", "tail_yaw"),
    "a limb of no group": Mutant(("{ group: left_arm,", "{ group: left_wing,"), "devices.hdt", "left_wing"),
    "no such servo": Mutant(
        ("joint: neck_yaw, model: XM540-W270", "joint: neck_yaw, model: AX-12"), "devices.neck.servos.0.model"
    ),
    "an offset of nobody": Mutant(("offsets: { l_hip_yaw", "offsets: { l_hip"), "calibration.offsets.l_hip"),
    "hung outside limits": Mutant(
        ("  tolerance: 0.05\n", "  tolerance: 0.05\n  pose: { l_knee_pitch: -1 }\n"),
        "calibration.pose.l_knee_pitch",
    ),
    "flat above low": Mutant(added("supply: { flat: 50 }\n"), "supply.flat", "less than low"),
    "no such model": Mutant(("model: model.xml", "model: thor.xml"), "model", "no file"),
    "a joint of no hinge": Mutant((("l_knee_pitch", "l_knee"),), "joints.l_knee", "expected a hinge"),
}

PROFILE: dict[str, Mutant] = {
    "a process twice": Mutant(
        ("  - comms_manager\n", "  - comms_manager\n  - comms_manager\n"), "processes.2", "second time"
    ),
    "a misspelt process": Mutant(("- comms_manager", "- coms_manager"), "processes.1", "did you mean 'comms_manager'?"),
    "a process without its need": Mutant(("  - bifrostd\n", ""), "processes.0", "needs bifrostd"),
    "processes as a text": Mutant(("processes:", "processes: bifrostd\nothers:"), "processes", "expected a list"),
    "no process": Mutant(("processes:", "processes: []\nothers:"), "processes", "length >= 1"),
    "the vendor's driver in a simulation": Mutant(
        ("- comms_manager", "- hdt_driver"), "processes.1", "variant: hardware"
    ),
    "dance": Mutant(
        ("initial_mode: stand ", "initial_mode: dance "), "initial_mode", "one of none, freeze, stand_prep"
    ),
    "a mode that is not reached from the start": Mutant(
        ("initial_mode: stand ", "initial_mode: walk "), "initial_mode"
    ),
    "a mode without a controller": Mutant(("  - valor_ros_controller\n", ""), "initial_mode", "valor_ros_controller"),
    "off": Mutant(("initial_mode: stand ", "initial_mode: off "), "initial_mode", "got off"),
    "7 Hz": Mutant(("initial_mode:", "control_rate: 7\ninitial_mode:"), "control_rate", "got 7"),
    "a rate of no whole steps": Mutant(
        ("initial_mode:", "control_rate: 300\ninitial_mode:"), "control_rate", "physics_step, 0.001"
    ),
    "another variant": Mutant(("initial_mode:", "variant: real\ninitial_mode:"), "variant", "hardware or simulation"),
    "ports of nothing": Mutant(("initial_mode:", "ports: { imo: /dev/ttyACM0 }\ninitial_mode:"), "ports.imo", "'imu'?"),
    "another clock": Mutant(("clock: lockstep", "clock: sundial"), "defaults.clock", "lockstep or realtime"),
    "no such robot": Mutant(("robot: escher", "robot: atlas"), "defaults.robot", "one of escher, thor"),
    "no such actuators": Mutant(("actuators: hardware", "actuators: magic"), "defaults.actuators", "ideal"),
    "no such world": Mutant(("world: flat", "world: moon"), "defaults.world", "flat"),
    "Norway": Mutant(("world: flat", "world: no"), "defaults.world", "got no"),
    "half a seed": Mutant(("seed: 0", "seed: 0.5"), "defaults.seed", "expected int"),
    "a seed below zero": Mutant(("seed: 0", "seed: -1"), "defaults.seed", ">= 0"),
    "time that runs backwards": Mutant(("factor: 1.0", "factor: -1"), "defaults.real_time_factor", ">= 0"),
    "infinite time": Mutant(("factor: 1.0", "factor: .inf"), "defaults.real_time_factor", "finite"),
    "defaults twice": Mutant(("initial_mode:", "defaults: {}\ninitial_mode:"), "defaults", "stands twice"),
    "a bound in parsecs": Mutant(("seed: 0", "bag_bound: [5 parsecs]"), "defaults.bag_bound", "expected a size"),
    "nothing": Mutant(("description:", "# description:"), "description", "missing"),
}

GET_UP: dict[str, Mutant] = {
    "a joint that the robot has not": Mutant(("l_hip_pitch", "tail"), "face_down.0.joints", "unknown joint 'tail'"),
    "balance by a tail": Mutant(("[l_ankle_pitch,", "[tail,"), "balance.joints", "unknown joint 'tail'"),
    "a knee in degrees": Mutant(
        ("l_knee_pitch: 0.3", "l_knee_pitch: 17"), "face_down.0.joints.l_knee_pitch", "got 17 rad"
    ),
    "a pitch from more to less": Mutant(("[60, 120]", "[120, 60]"), "face_down.0.pitch", "got 120 to 60"),
    "half a pitch": Mutant(("[60, 120]", "[60]"), "face_down.0.pitch", "length >= 2"),
    "a pose in no time": Mutant(("duration: 1.2", "duration: 0"), "face_down.0.duration", "> 0"),
    "a pose of nothing": Mutant(("out\n    duration: 1.2", "out"), "face_down.0.duration", ""),
    "no way up": Mutant(("face_down:", "face_up:"), "face_up", "did you mean"),
    "the roll twice": Mutant(("roll: 30", "roll: 30\nroll: 40"), "roll", "stands twice"),
}


PATTERN = r"(?P<file>.*\.(yaml|xml)):(?P<line>\d+):\d+: (?P<key>\S+|\(whole file\)): (?P<what>.+)"


def changed(file: Path, mutant: Mutant) -> None:
    """Write the change into a file."""
    text = file.read_text()
    changes = mutant.change if isinstance(mutant.change[0], tuple) else (mutant.change,)
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new) if len(changes) == 1 and old == KNEE else text.replace(old, new, 1)
    file.write_text(text)


def require_told(error: ConfigurationError, mutant: Mutant) -> None:
    """A line for each fault, one of which is this: a file, a line that has the key, the key, and what is expected."""
    faults = SeveralFaultsError.each(error)
    found = [re.fullmatch(PATTERN, str(fault)) for fault in faults]
    assert all(found), error
    matching = [told for told in found if told and mutant.key in {"", told["key"]} and mutant.told in told["what"]]
    assert matching, error
    told = matching[0]
    if mutant.key:
        last = mutant.key.rpartition(".")[2]
        text = Path(told["file"]).read_text()
        if last.isidentifier() and f"{last}:" in text and "missing" not in told["what"]:
            assert last in text.splitlines()[int(told["line"]) - 1]


FILES = [("robot.yaml", name) for name in ROBOT] + [("get_up.yaml", name) for name in GET_UP]


@pytest.mark.parametrize(("changed_file", "name"), FILES)
def test_a_robot_that_cannot_be_right_is_refused(tmp_path: Path, changed_file: str, name: str) -> None:
    for file in ("model.xml", "robot.yaml", "get_up.yaml"):
        if file != changed_file:
            (tmp_path / file).symlink_to(ESCHER / file)
    mutant = ROBOT[name] if changed_file == "robot.yaml" else GET_UP[name]
    shutil.copyfile(ESCHER / changed_file, tmp_path / changed_file)
    changed(tmp_path / changed_file, mutant)
    with pytest.raises(ConfigurationError) as refused:
        instance_setup.plan(Request(robot=str(tmp_path)))
    require_told(refused.value, mutant)


@pytest.mark.parametrize("mutant", PROFILE.values(), ids=PROFILE.keys())
def test_a_profile_that_cannot_be_right_is_refused(tmp_path: Path, mutant: Mutant) -> None:
    file = tmp_path / "mine.yaml"
    sim = resources.profile_file("sim")
    listed = "".join(f"  - {name}\n" for name in Profile.load(sim).processes)
    file.write_text(sim.read_text().replace("initial_mode:", f"processes:\n{listed}initial_mode:", 1))
    changed(file, mutant)
    with pytest.raises(ConfigurationError) as refused:
        instance_setup.plan(Request(profile=str(file)))
    require_told(refused.value, mutant)


@pytest.mark.parametrize("profile", resources.profiles())
@pytest.mark.parametrize("robot", resources.robots())
def test_ours_are_right(robot: str, profile: str) -> None:
    instance_setup.plan(Request(robot=robot, profile=profile))


LINES = (ESCHER / "robot.yaml").read_text().splitlines(keepends=True)
NUMBER = re.compile(r"(?<![\w.])-?\d+(\.\d+)?(?![\w.])")
WORD = re.compile(r"\b[a-z]+_[a-z_]+\b")


@given(st.data())
@examples(60)
def test_whatever_is_changed_is_taken_or_refused(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    """Some numbers, names and lines are replaced, left out or doubled: nothing but a configuration error is raised."""
    lines = list(LINES)
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(lines) - 1))
        other = data.draw(st.sampled_from(LINES))
        number = data.draw(st.sampled_from(["0", "-1", "0.3", "7", "1e9", "-1e-9", "[]", "{}", "null"]))
        word = data.draw(st.sampled_from(WORD.findall(other) or ["nobody"]))
        lines[place] = data.draw(
            st.sampled_from(
                [NUMBER.sub(number, lines[place], 1), WORD.sub(word, lines[place], 1), "", lines[place] * 2]
            )
        )
    folder = tmp_path_factory.mktemp("robot")
    (folder / "model.xml").symlink_to(ESCHER / "model.xml")
    (folder / "robot.yaml").write_text("".join(lines))
    try:
        require_sound(folder)
    except ConfigurationError as error:
        assert all(str(fault) and "\n" not in str(fault) for fault in SeveralFaultsError.each(error))
