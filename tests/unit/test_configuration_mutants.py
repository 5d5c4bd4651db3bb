"""Invalid configurations: each gives one line with file, line and key before anything starts."""

import re
import shutil
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from benchmarks.mutants import MUTATED, Mutation, mutants, written
from harness.examples import examples
from harness.places import ROBOTS
from valor.common import resources
from valor.common.errors import ConfigurationError, SeveralFaultsError
from valor.robot.checks.folder import Findings
from valor.valorctl.instance import instance_setup
from valor.valorctl.instance.instance_setup import Request
from valor.valorctl.instance.profile import Profile
from valor.valorctl.robots.robot_check import examine
from valor.valorctl.terminal.app import app

ESCHER = ROBOTS / "escher"
LEFT_LEG, RIGHT_LEG = (
    f"{side}_hip_yaw, {side}_hip_roll, {side}_hip_pitch, {side}_knee_pitch, {side}_ankle_pitch, {side}_ankle_roll"
    for side in "lr"
)


class Mutant(NamedTuple):
    """A file that was changed, and what is said of it."""

    change: tuple[str, str] | tuple[tuple[str, str], ...]
    key: str  # the line that is named has its last part, unless that is a place in a list
    reported: str = ""


def swap(one: str, other: str) -> tuple[tuple[str, str], ...]:
    return ((one, "\0"), (other, one), ("\0", other))


def rows(table: str) -> dict[str, Mutant]:
    found = {}
    for row in table.strip("\n").splitlines():
        name, old, new, key, reported = (
            cell.removeprefix(" ").removesuffix(" ").replace(r"\n", "\n") for cell in row.split("|")
        )
        found[name] = Mutant((old, new), key, reported)
    return found


KNEE = "l_knee_pitch"
# A row a mutant: name, what is replaced, by what, the key and words that are reported. What is before an ellipsis finds
# the place in its line and stays; in what comes instead, an ellipsis is what was there.
ROBOT = rows(r"""
the right sole on the left foot | l_foot, sole: l_sole | l_foot, sole: r_sole | feet.right.sole |
heel and toe swapped | heel: -0.10, toe: 0.15 | heel: 0.15, toe: -0.10 | feet.left.heel | less than toe
heel and toe mirrored | heel: -0.10, toe: 0.15 | heel: -0.15, toe: 0.10 | feet.left.heel | expected -0.100
a sole 1 m wide | 0.07425 | 0.5 | feet.left.half_width | expected 0.074
five joints a leg | r_ankle_pitch, r_ankle_roll] | r_ankle_pitch] | groups.right_leg | 5 joints; expected 6
a joint in both legs | r_ankle_pitch, r_ankle_roll] | r_ankle_pitch, l_ankle_roll] | groups.right_leg.5 |
a joint in no group | l_hip_pitch, l_knee_pitch, | l_hip_pitch, | joints.l_knee_pitch | in no group
a group with an unknown joint | [neck_yaw, | [neck, | groups.neck.0 | got 'neck'
another chest | chest: chest | chest: l_foot | groups.torso | expected
another base | base: pelvis | base: chest | base | pelvis
the IMU on a foot | imu: { site: imu } | imu: { site: l_sole } | imu.site | on l_foot
no such frame | l_ankle: l_foot | l_ankle: l_tail | link_frames.l_ankle | l_tail
limits the wrong way round | l_knee_pitch: …lower: 0, | lower: 3, | joints.l_knee_pitch.lower | less than upper
half a limit | l_knee_pitch: …lower: 0,  | | joints.l_knee_pitch | both lower and upper
limits of another sign | l_knee_pitch: …0, upper: 2.356 | -2.356, upper: 0 | nominal_posture.l_knee_pitch | -2.356 to 0
a hip too weak for one leg | l_hip_roll: …150 | 30 | joints.l_hip_roll.effort | standing on the left foot
zero ankle stiffness | l_ankle_roll: …stiffness: 1000 | stiffness: 0 | joints.l_ankle_roll.servo.stiffness | gives way
a servo too strong for its finger | l_thumb_pitch: …0.2 | 20 | joints.l_thumb_pitch.servo.damping | at most
a servo that oscillates | l_knee_pitch: …damping: 100 | damping: 1 | joints.l_knee_pitch.servo.damping |
a knee at 3 rad | l_knee_pitch: 0.9719 | l_knee_pitch: 3 | nominal_posture.l_knee_pitch | 0.0 to 2.356
a base 1.6 m high | height: 0.8050 | height: 1.6 | nominal_base_height | expected 0.8050
one knee straight | l_knee_pitch: 0.9719 | l_knee_pitch: 0.1 | nominal_posture |
feet that tilt | l_ankle_pitch: -0.5026 | l_ankle_pitch: -0.4 | nominal_posture | tilts l_sole
a preset outside limits | l_shoulder_pitch: -2.5, | l_shoulder_pitch: -25, | arm_presets.up.left.l_shoulder_pitch |
no size | size: { leg: 0.82, mass: 75.9 }\n | | size | missing
a mass in pounds | mass: 75.9 | mass: 167 | size.mass | the model's 75.9
periods of no whole steps | physics_step: 0.001 | physics_step: 0.0015 | physics_step | whole number
a tilt in degrees | r_toe: r_toe\n | …fall: { tilt: 35 }\n | fall.tilt | got 35
an edge margin wider than the sole | r_toe\n | …disturbance: { edge_margin: 0.08 }\n | disturbance.edge_margin | half
legs longer than they are | r_toe: r_toe\n | …walking: { leg_reach: 0.9 }\n | walking.leg_reach | straight leg
hips lower than they are | r_toe: r_toe\n | …walking: { hip_height: 0.5 }\n | walking.hip_height | expected 0.725
feet in one line | r_toe: r_toe\n | …walking: { step_width: 0.05 }\n | walking.step_width | as of footsteps
feet on each other | footsteps: {} | footsteps: { min_width: 0.05 } | footsteps.min_width | soles touch
the least above the most | footsteps: {} | footsteps: { min_width: 1.5 } | footsteps.min_width | less than max_width
kept farther apart than they are | self_collision:\n | …  distance: 0.06\n  near: 0.1\n | self_collision.distance | 0.05
a spring of nobody | { l_hip_yaw: 2, | { l_hip: 2, | actuators.series_elastic.springs.actuators.l_hip | whose armature
gears of nobody | left_arm: &hdt | left_wing: &hdt | actuators.hdt_arms.gears.left_wing |
two with one id | { id: 2, at: right_foot | { id: 1, at: right_foot | devices.force_torque.sensors.1.id |
a joint on two drives | axes: [waist_yaw] | axes: [l_hip_yaw] | devices.legs | drives as well
a limb of no group | { group: left_arm, | { group: left_wing, | devices.hdt | left_wing
hung outside limits | tolerance: 0.05\n | …  pose: { l_knee_pitch: -1 }\n | calibration.pose.l_knee_pitch |
flat above low | r_toe: r_toe\n | …supply: { flat: 50 }\n | supply.flat | less than low
a joint of no hinge | l_knee_pitch | l_knee | joints.l_knee | expected a hinge
legs that crawl | l_knee_pitch: …12 | 0.05 | joints.l_knee_pitch.velocity | expected at least 0.98 rad/s
a joint in tar | l_wrist_pitch: …0.01, damping: 0.2 | 0.01, damping: 2000 | joints.l_wrist_pitch.damping | at most 287
a rotor of lead | l_wrist_pitch: …armature: 0.01 | armature: 1e4 | joints.l_wrist_pitch.armature | at most 287
a gyroscope of noise | gyroscope: 0.005 | gyroscope: 5000 | actuators.hardware.noise.gyroscope | got 5000
an encoder half a turn off | { l_hip_yaw: 0.021 | { l_hip_yaw: 3 | calibration.offsets.l_hip_yaw | <= 0.5 rad, got 3
a name that rings | name: escher | name: "esc\aher" | name | got 'esc\x07her'
""") | {
    "a leg's group missing": Mutant((f"  left_leg: [{LEFT_LEG}]\n", ""), "groups.left_leg", "missing"),
    "a name that turns the text": Mutant(
        ("  head: head\n", '  head: "h\u202eead"\n'), "link_frames.head", r"got 'h\u202eead'; expected printable"
    ),
    "feet swapped": Mutant(swap("l_foot, sole: l_sole", "r_foot, sole: r_sole"), "feet.left.body", "other side"),
    "legs swapped": Mutant(swap(LEFT_LEG, RIGHT_LEG), "groups.left_leg", "expected l_hip_yaw"),
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
        "below l_hand",
    ),
    "ankles too soft to stand": Mutant(
        tuple((f"{side}_ankle_pitch: …1500", "200") for side in "lr"),
        "joints.l_ankle_pitch.servo.stiffness",
        "falls in Stand Prep",
    ),
    "leaning over the toes": Mutant(
        (
            *((f"  {side}_hip_pitch: -0.4693", f"  {side}_hip_pitch: -0.25") for side in "lr"),
            *((f"  {side}_ankle_pitch: -0.5026", f"  {side}_ankle_pitch: -0.7219") for side in "lr"),
            ("height: 0.8050", "height: 0.785"),
        ),
        "nominal_posture",
        "CoM -0.003 m inside",
    ),
    "arms in the chest": Mutant(
        (("l_shoulder_roll: 0.2\n", "l_shoulder_roll: -0.5\n"), ("l_elbow_pitch: 0.5\n", "l_elbow_pitch: 2.4\n")),
        "nominal_posture",
        "touches",
    ),
    "an arm preset in the chest": Mutant(
        (
            "l_shoulder_roll: 0.15, l_shoulder_yaw: -0.5, l_elbow_pitch: 0,",
            "l_shoulder_roll: -0.5, l_shoulder_yaw: -1.5, l_elbow_pitch: 0.3,",
        ),
        "arm_presets.fold.left",
        "touches",
    ),
}  # fmt: skip

THIGH = '<inertial mass="7.1" pos="0.005 0.005 -0.175" diaginertia="0.086679 0.086679 0.019998"/>'
INERTIAS = re.findall(r'diaginertia="([^"]+)"', (ESCHER / "model.xml").read_text())
MODEL = rows(r"""
gravity up | integrator="implicitfast" | … gravity="0 0 9.81" | option | got 0 0 9.81; expected 0 0 -
no gravity | integrator="implicitfast" | … gravity="0 0 0" | option | gravity
gravity aside | integrator="implicitfast" | … gravity="0 9.81 -9.81" | option | gravity
no gravity by a flag | <option …/> | ><flag gravity="disable"/></option> | option | flags that disable gravity
a place that is no number | "0.005 0.005 -0.175" | "0.005 NaN -0.175" | (whole file) | got NaN
a storm | integrator="implicitfast" | … wind="0 100 0" density="1000" | option | wind: got [  0. 100.   0.]
no iterations | integrator="implicitfast" | … iterations="0" | option | iterations: got 0; expected 5 to
a hip that is drawn turned | name="l_hip_yaw" axis | name="l_hip_yaw" ref="1" axis | joint.l_hip_yaw | got ref 1
an IMU in orbit | name="imu" pos="0 0 0.06" | name="imu" pos="0 0 60000" | imu.site | from the base
a heel that feels from afar | class="sole" …name="l_heel_left" | margin="0.5" … | geom.l_heel_left | margin
soles of two kinds | solref="0.005 1" | solref="-1 1" | geom.l_heel_left | solref -1 1
a hand of 48 km | size="0.125 0.07425 0.02" | size="0.125 0.07425 48000" | geom.l_foot_body | from its body
a thigh through the ground | fromto="0 0 -0.1 0 0 -0.32" | fromto="0 0 -0.1 0 0 -1" | body.l_thigh | below the ground
a thigh's CoM 1 m aside | "0.005 0.005 -0.175" | "0.005 1.005 -0.175" | body.l_thigh | m outside its joints
inertias a million times | "0.086679 0.086679 0.019998" | "86679 86679 19998" | body.l_thigh | inertia
a weightless thigh | mass="7.1" | mass="7.1e-6" | size.mass | expected the model's 68.8
soles of glue | type="sphere" size="0.01" …0.9 | 50 | geom.l_heel_left | got friction 50; expected 0.1 to 5
a sole above the foot's underside | name="l_sole" pos="0 0 …-0.08" | -0.073" | feet.left.sole | above the lowest
no XML | </worldbody> | </world> | | MISMATCHED
a sole without a site | site name="l_sole" | site name="sole" | feet.left.sole | got 'l_sole'
degrees | angle="radian" | angle="degree" | compiler | expected radian
a missing mesh | <worldbody> | <asset><mesh name="head" file="head.stl"/></asset><worldbody> | mesh.head.stl | no file
""") | {
    "a body without mass": Mutant((THIGH, ""), "body.l_thigh", "no mass"),
    "a geom that turns the text": Mutant(
        ("l_foot_body", "l_foot_\u202ebody"), r"geom.l_foot_\u202ebody", "expected printable"
    ),
    "coupled joints": Mutant(
        ("</worldbody>", '…<equality><joint joint1="l_hip_roll" joint2="r_hip_roll"/></equality>'),
        "joint.l_hip_roll", "independent",
    ),
    "inertias of a millionth": Mutant(
        tuple((f'"{each}"', f'"{" ".join(f"{x}e-6" for x in each.split())}"') for each in INERTIAS if "e" not in each),
        "body.l_thigh", "inertia",
    ),
}  # fmt: skip

PROFILE = rows(r"""
a process twice |   - comms_manager\n | …… | processes.2 | second time
a misspelt process | - comms_manager | - coms_manager | processes.1 | did you mean 'comms_manager'?
a process without its need |   - bifrostd\n | | processes.0 | needs bifrostd
no process | processes: | … []\nothers: | processes | length >= 1
the vendor's driver in a simulation | - comms_manager | - hdt_driver | processes.1 | variant: hardware
dance | initial_mode: stand | initial_mode: dance | initial_mode | one of none, freeze, stand_prep
a mode that is not reached from the start | initial_mode: stand | initial_mode: walk | initial_mode |
a mode without a controller |   - valor_ros_controller\n | | initial_mode | valor_ros_controller
ports of nothing | initial_mode: | ports: { imo: /dev/ttyACM0 }\n… | ports.imo | 'imu'?
a bound in parsecs | seed: 0 | bag_bound: [5 parsecs] | defaults.bag_bound | expected a size
a sundial | clock: lockstep | clock: sundial | defaults.clock | expected
a world that crawls | real_time_factor: 1.0 | real_time_factor: 0.000001 | defaults.real_time_factor | at least 0.01
nothing | description: | # description: | description | missing
""")

GET_UP = rows(r"""
a joint that the robot has not | l_hip_pitch | tail | motions.0.poses.0.joints | unknown joint 'tail'
a knee in degrees | l_knee_pitch: 1.423 | l_knee_pitch: 17 | motions.0.poses.0.joints.l_knee_pitch | got 17 rad
a pitch from more to less | [91, 158] | [158, 91] | motions.0.poses.0.pitch | got 158 to 91
a pose in a millisecond | duration: 1.85 | duration: 0.001 | motions.0.poses.1.duration | >= 0.1 s
too fast | duration: 1.85 | duration: 0.1 | motions.0.poses.1.duration | at least 1.84
a motion to where no other starts | to: standing | to: nowhere | motions.0.to | 'nowhere'
""")

HARDWARE = rows(r"""
a leg joint on no device | axes: [l_ankle_pitch…, l_ankle_roll] | ] | devices | none moves l_ankle_roll
""") | {
    "no IMU": Mutant((("    kind: microstrain_mip\n    model: 3DM-GX4-25\n    serial: \"6234.40117\"\n"
                      "    firmware: \"1.1.26\"\n    rate: 250\n",
                      "    kind: ft_can\n    bus: 2\n"
                      "    sensors: [{ id: 9, at: left_hand, serial: FT-25-0204, firmware: \"2.3\" }]\n"),
                      ("  kvh: { kind: kvh_1750, serial: \"1750-0042\", rate: 250 }", "")),
                     "devices", "0 IMUs; expected one"),
    "a foot without a sensor": Mutant(
        ("      - { id: 2, at: right_foot, serial: FT-45-0118, firmware: \"2.3\" }\n", ""), "devices",
        "no force/torque sensor at right_foot",
    ),
}  # fmt: skip


PATTERN = r"(?P<file>.*\.(yaml|xml)):(?P<line>\d+):\d+: (?P<key>\S+|\(whole file\)): (?P<what>.+)"


def changed(file: Path, mutant: Mutant) -> None:
    text = file.read_text()
    changes = mutant.change if isinstance(mutant.change[0], tuple) else (mutant.change,)
    for old, new in changes:
        head, _, tail = old.rpartition("…")
        found = re.search(f"{re.escape(head)}[^\n]*?{re.escape(tail)}" if head else re.escape(tail), text)
        assert found, old
        end = None if len(changes) == 1 and old == KNEE else found.end()
        start = found.end() - len(tail)
        text = text[:start] + text[start:end].replace(tail, new.replace("…", tail)) + (text[end:] if end else "")
    file.write_text(text)


def require_reported(error: ConfigurationError, mutant: Mutant) -> None:
    """A line for each fault, one of which is this: a file, a line that has the key, the key, and what is expected."""
    faults = SeveralFaultsError.each(error)
    found = [re.fullmatch(PATTERN, str(fault)) for fault in faults]
    assert all(found), error
    matching = [
        reported
        for reported in found
        if reported and mutant.key in {"", reported["key"]} and mutant.reported in reported["what"]
    ]
    assert matching, error
    reported = matching[0]
    if mutant.key:
        last = mutant.key.rpartition(".")[2]
        text = Path(reported["file"]).read_text()
        if last.isidentifier() and re.search(f'{last}[:"]', text) and "missing" not in reported["what"]:
            assert last in text.splitlines()[int(reported["line"]) - 1]


FILES = {"robot.yaml": ROBOT, "model.xml": MODEL, "get_up.yaml": GET_UP}


def folder_of(folder: Path, changed_file: str, *mutants: Mutant) -> Path:
    """ESCHER's, changed."""
    for file in FILES:
        if file != changed_file:
            (folder / file).symlink_to(ESCHER / file)
    shutil.copyfile(ESCHER / changed_file, folder / changed_file)
    for mutant in mutants:
        changed(folder / changed_file, mutant)
    return folder


@pytest.mark.parametrize(("changed_file", "name"), [(file, name) for file in FILES for name in FILES[file]])
def test_a_robot_that_cannot_be_right_is_refused(tmp_path: Path, changed_file: str, name: str) -> None:
    mutant = FILES[changed_file][name]
    folder = folder_of(tmp_path, changed_file, mutant)
    with pytest.raises(ConfigurationError) as refused:
        instance_setup.plan(Request(robot=str(folder)))
    require_reported(refused.value, mutant)


@pytest.mark.parametrize("mutant", HARDWARE.values(), ids=HARDWARE.keys())
def test_devices_that_lack_something_are_refused_on_hardware(tmp_path: Path, mutant: Mutant) -> None:
    folder = folder_of(tmp_path, "robot.yaml", mutant)
    instance_setup.plan(Request(robot=str(folder)))
    with pytest.raises(ConfigurationError) as refused:
        instance_setup.plan(Request(robot=str(folder), profile="hardware"))
    require_reported(refused.value, mutant)


def test_a_model_without_a_free_joint_is_a_fault(tmp_path: Path) -> None:
    findings = examine(folder_of(tmp_path, "model.xml", Mutant(('<freejoint name="floating_base"/>', ""), "")))
    assert any("0 free joints; expected one" in str(fault) for fault in findings.faults)


def keys(findings: Findings) -> set[str]:
    found = [re.fullmatch(PATTERN, str(fault)) for fault in findings.faults]
    return {reported["key"] for reported in found if reported}


def test_independent_faults_are_reported_together(tmp_path: Path) -> None:
    chosen = [
        ROBOT[name]
        for name in ("zero ankle stiffness", "a hip too weak for one leg", "an arm preset in the chest",
                     "an edge margin wider than the sole")
    ]  # fmt: skip
    folder = folder_of(tmp_path, "robot.yaml", *chosen)
    findings = examine(folder)
    assert keys(findings) == {each.key for each in chosen}
    with pytest.raises(ConfigurationError) as refused:
        instance_setup.plan(Request(robot=str(folder)))
    assert len(str(refused.value).splitlines()) == len(findings.faults) + len(findings.unchecked) + 1
    assert f"run `valorctl robot check {folder}`" in str(refused.value)
    result = CliRunner().invoke(app, ["robot", "check", str(folder), "--no-play", "--json"])
    assert isinstance(result.exception, ConfigurationError) and '"faults"' in result.output


def test_wrong_keys_are_reported_together(tmp_path: Path) -> None:
    wrong = (
        ("control_rate: 500", "control_rate: 7"),
        ("base: pelvis", "bass: pelvis"),
        ("half_width: 0.07425 }", "half_width: wide }"),
    )
    findings = examine(folder_of(tmp_path, "robot.yaml", Mutant(wrong, "")))
    assert keys(findings) == {"control_rate", "bass", "base", "feet.left.half_width"} and findings.unchecked


@pytest.mark.parametrize("mutant", PROFILE.values(), ids=PROFILE.keys())
def test_a_profile_that_cannot_be_right_is_refused(tmp_path: Path, mutant: Mutant) -> None:
    file = tmp_path / "mine.yaml"
    sim = resources.file_of("profile", "sim")
    listed = "".join(f"  - {name}\n" for name in Profile.load(sim).processes)
    file.write_text(sim.read_text().replace("initial_mode:", f"processes:\n{listed}initial_mode:", 1))
    changed(file, mutant)
    with pytest.raises(ConfigurationError) as refused:
        instance_setup.plan(Request(profile=str(file)))
    require_reported(refused.value, mutant)


@pytest.mark.parametrize("profile", resources.names("profile"))
@pytest.mark.parametrize("robot", resources.robots())
def test_ours_are_right(robot: str, profile: str) -> None:
    instance_setup.plan(Request(robot=robot, profile=profile))


FUZZED = [mutant for file in MUTATED for mutant in mutants(ESCHER / file)]


@given(st.lists(st.sampled_from(FUZZED), min_size=1, max_size=3))
@examples(60)
def test_any_change_is_taken_or_refused(tmp_path_factory: pytest.TempPathFactory, chosen: list[Mutation]) -> None:
    """Numbers are replaced, names exchanged, lines dropped: nothing but a configuration error is raised."""
    folder = tmp_path_factory.mktemp("robot")
    written(ESCHER, folder, *chosen)
    try:
        instance_setup.plan(Request(robot=str(folder), profile="hardware"))
    except ConfigurationError as error:
        assert all(str(fault).startswith(str(folder)) for fault in SeveralFaultsError.each(error))
        assert all("\n" not in str(fault) for fault in SeveralFaultsError.each(error))
