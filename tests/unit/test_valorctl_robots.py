"""``robot new`` and ``robot show`` as a person runs them: a folder or one line, and nothing half done."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import matplotlib.image
import mujoco
import pytest
from typer.testing import CliRunner

from harness.places import ROBOTS
from valor.robot.description import RobotDescription
from valor.robot_setup.new import study
from valor.robot_setup.questions import Question
from valor.robot_setup.sides import said_left
from valor.robot_setup.skeleton import skeleton
from valor.robot_setup.source import Source
from valor.valorctl.__main__ import run as main
from valor.valorctl.app import app

VALORCTL = Path(sys.executable).with_name("valorctl")
MODEL = ROBOTS / "escher" / "model.xml"
MESH = '<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody><body><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'  # noqa: E501


def without(*joints: str) -> str:
    """ESCHER's model without some of its joints."""
    lines = MODEL.read_text().splitlines()
    return "\n".join(line for line in lines if not any(f'<joint name="{name}"' in line for name in joints))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["valorctl", "robot", *arguments])
    try:
        return main()
    except SystemExit as ended:
        return int(ended.code or 0)


def test_a_model_becomes_a_folder_that_is_sound(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "new", str(MODEL), "--name", "mine", "--yes") == 0
    told = capsys.readouterr().out
    for words in ("mine: 38 joints, 75.9 kg", "l_knee_pitch, r_knee_pitch", " × 14.9 cm", "0.820 m"):
        assert words in told
    assert told.endswith("Next:\n  valorctl robot check mine\n  valorctl up --robot mine\n")
    assert sorted(file.name for file in here.iterdir()) == ["mine"]
    assert {"model.xml", "robot.yaml"} <= {file.name for file in (here / "mine").iterdir()}
    assert RobotDescription.load(here / "mine").name == "mine"


def test_a_folder_makes_way_only_when_told_to(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "mine").mkdir()
    (here / "mine" / "notes").touch()
    new = ("new", str(MODEL), "--name", "mine", "--yes")
    assert run(monkeypatch, *new) == 1
    assert "is there already" in capsys.readouterr().err
    assert run(monkeypatch, *new, "--force") == 1
    assert "robots' folders only" in capsys.readouterr().err
    (here / "mine" / "robot.yaml").touch()
    assert run(monkeypatch, *new, "--force") == 0
    assert not (here / "mine" / "notes").exists()
    assert run(monkeypatch, "new", "mine/model.xml", "--name", "mine", "--yes", "--force") == 1
    assert "made of" in capsys.readouterr().err
    assert sorted(file.name for file in here.iterdir()) == ["mine"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "expected a file, MJCF or URDF"),
        ("<mujoco><worl", "XML parse error"),
        ('<robot name="a" xmlns:xacro="x"><xacro:include filename="b"/></robot>', "xacro"),
        (MESH, "gone.stl"),
        ("<mujoco/>", "has no bodies"),
        ('<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>', "no two legs"),
        (without("l_ankle_roll", "r_ankle_roll"), "5 driven joints"),
    ],
    ids=["no-file", "unreadable", "xacro", "mesh", "empty", "ball", "five-joints"],
)
def test_what_cannot_be_a_robot_takes_one_line(
    content: str | None,
    words: str,
    here: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = []
    if content is not None:
        (here / "a.xml").write_text(content)
        before = ["a.xml"]
    status = run(monkeypatch, "new", "a.xml", "--name", "mine", "--yes")
    err = capsys.readouterr().err
    assert status == 1
    assert err.startswith("valorctl: a.xml: ")
    assert words in err
    assert err.count("\n") == 1
    assert sorted(file.name for file in here.iterdir()) == before


def test_a_foot_without_an_underside_is_refused(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Feet of bones alone: bodies without a shape."""
    tree = study(MODEL, "mine").content.robot
    feet = {tree.name(leg.end) for leg in tree.legs.values()}
    spec = mujoco.MjSpec.from_file(str(MODEL))
    for geom in list(spec.geoms):
        if geom.parent.name in feet:
            spec.delete(geom)
    spec.compile()
    (here / "a.xml").write_text(spec.to_xml())
    assert run(monkeypatch, "new", "a.xml", "--name", "mine", "--yes") == 1
    assert "no flat underside" in capsys.readouterr().err
    assert sorted(file.name for file in here.iterdir()) == ["a.xml"]


def test_the_name_is_asked_for(here: Path) -> None:
    answered = CliRunner().invoke(app, ["robot", "new", str(MODEL)], input="other\n")
    assert answered.exit_code == 0, answered.output
    assert "name of the robot [escher]" in answered.output
    assert (here / "other" / "robot.yaml").is_file()


def test_nobody_there_to_answer_takes_one_line(here: Path) -> None:
    told = subprocess.run(
        [VALORCTL, "robot", "new", MODEL], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert (told.returncode, told.stderr) == (
        1,
        "valorctl: name of the robot: nobody answers; expected an answer, or --yes\n",
    )
    assert list(here.iterdir()) == []


def test_ctrl_c_at_a_question_leaves_nothing(here: Path) -> None:
    mine, theirs = pty.openpty()
    process = subprocess.Popen(
        [VALORCTL, "robot", "new", MODEL], stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True
    )
    told = b""
    while b"name of the robot" not in told:
        told += os.read(mine, 1024)
    status = None
    while status is None:  # C code that is about to read a line may overlook a signal: a person presses again, too
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            status = process.wait(timeout=2)
    assert status == 128 + signal.SIGINT
    os.close(theirs)
    os.close(mine)
    assert list(here.iterdir()) == []


def asked_of(
    content: str, folder: Path, answers: dict[str, str]
) -> tuple[list[Question], Source, dict[str, list[str]]]:
    """The questions that a model leaves open, with answers to words in them; and the legs' joints."""
    file = folder / "a.xml"
    file.write_text(content)
    questions = []

    def ask(question: Question) -> str:
        questions.append(question)
        return next((answer for word, answer in answers.items() if word in question.text), question.guess)

    source = Source(file)
    found = skeleton(source, ask)
    return questions, source, {side: [found.joint_name(j) for j in leg.joints] for side, leg in found.legs.items()}


SWAPPED = (
    MODEL.read_text().replace('name="l_', 'name="x_').replace('name="r_', 'name="l_').replace('name="x_', 'name="r_')
)


@pytest.mark.parametrize(("answer", "first"), [("feet", "r_hip_yaw"), ("names", "l_hip_yaw")])
def test_who_is_right_where_names_contradict_the_feet_is_asked(answer: str, first: str, tmp_path: Path) -> None:
    before, _, contact = SWAPPED.partition("<contact>")  # which names bodies
    content = before + contact.partition("</contact>")[2]
    questions, source, legs = asked_of(content, tmp_path, {"who is right": answer})
    assert [question.choices for question in questions] == [("feet", "names")]
    assert legs["left"][0] == first
    assert any("contradict" in note for note in source.notes)


def test_what_nothing_drives_is_asked(tmp_path: Path) -> None:
    model = MODEL.read_text().replace(
        "</mujoco>", "<actuator>" + "".join(f'<motor joint="{name}"/>' for name in driven()) + "</actuator></mujoco>"
    )
    questions, _, _ = asked_of(model, tmp_path, {})
    assert len(questions) == 1
    assert "neck_yaw" in questions[0].text
    assert questions[0].guess == "weld"
    file = tmp_path / "a.xml"
    assert list(skeleton(Source(file)).passive.hinges.values()) == [False]
    assert skeleton(Source(file), lambda question: "servo").passive.hinges == {}


def driven() -> list[str]:
    """ESCHER's joints but one."""
    return [name for name in RobotDescription.load(ROBOTS / "escher").joints if name != "neck_yaw"]


@pytest.mark.parametrize(
    "name", ["l_hip", "LHipYaw", "hipLeft", "Left_Hip_Roll", "left_hip_pitch_joint", "leg_l1_joint"]
)
def test_names_say_left(name: str) -> None:
    assert said_left([name]) == 1


@pytest.mark.parametrize("name", ["lower_leg", "upper_roll", "", "pelvis", "hip"])
def test_names_say_nothing(name: str) -> None:
    assert said_left([name]) == 0


def test_the_picture_shows_the_robot(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, "show", "escher") == 0
    image = matplotlib.image.imread(here / "escher.png")[:, :, :3]
    width = image.shape[1]
    for part in (image[:, : width // 4], image[:, width // 2 :]):
        assert part.std() > 0.05
    blue = (image[:, width // 4 : width // 2, 2] - image[:, width // 4 : width // 2, 0]) > 0.15
    assert blue.mean() > 0.02  # what touches


def test_where_the_picture_cannot_be_written_takes_one_line(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "file").touch()
    assert run(monkeypatch, "show", "escher", "--out", "file/a.png") == 1
    err = capsys.readouterr().err
    assert err.startswith("valorctl: file/a.png: ")
    assert err.count("\n") == 1
