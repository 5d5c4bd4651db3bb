"""The planner of Get Up: what it finds stands in MuJoCo, what cannot stand is refused, the table is what it wrote."""

from pathlib import Path
from shutil import copytree

import mujoco
import numpy as np
import pytest
from msgspec import structs

from harness.places import ROBOTS
from valor.common.table import read
from valor.get_up_planning import key_poses
from valor.get_up_planning.__main__ import main, plan
from valor.get_up_planning.key_poses import PLAN_FILE, ContactPoints, GetUpPlan, PlannedPose, check, find, posture_of
from valor.get_up_planning.posture import BASE, SagittalPosture
from valor.motion_manager.locomotion.get_up import GetUp
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import FILE
from valor.robot.model import full_model

ESCHER, THOR = (RobotDescription.load(ROBOTS / name) for name in ("escher", "thor"))
PLAN = read(GetUpPlan, ROBOTS / "escher" / PLAN_FILE)
LEGS = ("l_hip_pitch", "l_knee_pitch", "l_ankle_pitch", "l_shoulder_pitch")


def standing(robot: RobotDescription, **changes: object) -> GetUpPlan:
    """A plan of one pose: knees bent, on both soles."""
    foot = robot.tables.feet.left
    corners = {
        name: ContactPoints(body=foot.body, points=[[x, y * foot.half_width, -0.08] for y in (1, -1)], friction=0.6)
        for name, x in (("toe", foot.toe), ("heel", foot.heel))
    }
    near = {"l_hip_pitch": -0.8, "l_knee_pitch": 1.5, "l_ankle_pitch": -0.7}
    pose = PlannedPose(name="squat", duration=1.0, pitch=[-40, 40], near=near, loaded=["toe", "heel"])
    return structs.replace(PLAN, moved=list(LEGS), contacts=corners, face_down=[structs.replace(pose, **changes)])


@pytest.mark.parametrize("robot", [ESCHER, THOR], ids=["escher", "thor"])
def test_a_pose_on_both_soles_stands_in_mujoco(robot: RobotDescription) -> None:
    wanted = standing(robot, com=[-0.13, -0.12], com_of="toe")
    posture = posture_of(full_model(robot, "collision"), wanted)
    (pose,) = find(posture, wanted)
    seen = check(posture, wanted.contacts, pose)
    assert np.abs(seen.unbalanced).max() < 1e-4  # N, N·m
    assert seen.torque <= wanted.torque + 1e-6 and seen.depth < 0.003
    data = mujoco.MjData(posture.model.mj)
    data.qpos[:] = posture.qpos(pose.coordinates)
    mujoco.mj_forward(posture.model.mj, data)
    toe = data.xpos[posture.model.body("l_foot")][0] + robot.tables.feet.left.toe
    assert -0.13 - 1e-3 < data.subtree_com[1][0] - toe < -0.12 + 1e-3
    for forces in pose.forces.values():
        assert (np.hypot(forces[:, 0], forces[:, 1]) <= 0.6 * forces[:, 2] + 1e-4).all()
    posed = dict(zip(posture.joints, pose.coordinates[BASE:], strict=True))
    assert posed["l_knee_pitch"] > 1.0  # near to what was wished


@pytest.mark.parametrize(
    "changes",
    [
        {"com": [0.05, 0.1], "com_of": "toe"},  # ahead of its toes it falls
        {"pitch": [-95, -85]},  # so far back the ankles and hips do not let it lean
    ],
)
def test_where_no_pose_can_be_it_reports_it(changes: dict[str, object]) -> None:
    wanted = standing(ESCHER, **changes)
    with pytest.raises(key_poses.NoSolutionFound, match=r"squat"):
        find(posture_of(full_model(ESCHER, "collision"), wanted), wanted)


def test_both_sides_do_the_same() -> None:
    posture = SagittalPosture(full_model(ESCHER), ("l_hip_roll", "l_hip_yaw", "l_elbow_pitch", "waist_yaw"))
    model = posture.model
    data = mujoco.MjData(model.mj)
    data.qpos[:] = posture.qpos(np.array([0.1, 0.8, 0.3, 0.4, 0.2, 0.7, 0.0]))
    mujoco.mj_forward(model.mj, data)
    for body in ("foot", "hand"):
        left, right = (data.xpos[model.body(side + body)] for side in ("l_", "r_"))
        assert np.allclose(left * (1, -1, 1), right, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("l_hip_roll,", "tail,", "no joint 'tail'"),
        ("body: l_shin", "body: shovel", "contacts: knee: no body 'shovel'"),
        ("loaded: [inner toe, knee]", "loaded: [tail]", "hands off: unknown contact 'tail'"),
        ("torque: 0.8", "torque: 1.8", "torque"),
    ],
)
def test_a_wrong_plan_is_refused_by_name_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, old: str, new: str, words: str
) -> None:
    folder = copytree(ROBOTS / "escher", tmp_path / "escher")
    file = folder / PLAN_FILE
    file.write_text(file.read_text().replace(old, new, 1))
    before = (folder / FILE).read_bytes()
    monkeypatch.setattr("sys.argv", ["valor.get_up_planning", str(folder)])
    assert main() == 1
    assert words in capsys.readouterr().err
    assert (folder / FILE).read_bytes() == before


def test_eschers_table_is_what_its_plan_gives(tmp_path: Path) -> None:
    folder = copytree(ROBOTS / "escher", tmp_path / "escher")
    found, content = plan(folder)
    posture = posture_of(full_model(ESCHER, "collision"), PLAN)
    assert [pose.plan.name for pose in found] == [pose.name for pose in PLAN.face_down if pose.loaded]
    for pose in found:
        seen = check(posture, PLAN.contacts, pose)
        assert np.abs(seen.unbalanced).max() < 1e-3 and seen.torque <= PLAN.torque + 1e-6
    (folder / FILE).write_text(content)
    made, kept = (GetUp(RobotDescription.load(at)) for at in (folder, ROBOTS / "escher"))
    assert all(
        np.allclose(made.ways[way].goals, kept.ways[way].goals, atol=0.02) for way in kept.ways
    )  # another machine's IPOPT ends a little elsewhere


def test_a_robot_without_a_plan_is_named(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["valor.get_up_planning", str(ROBOTS / "thor")])
    assert main() == 1
    assert PLAN_FILE in capsys.readouterr().err
