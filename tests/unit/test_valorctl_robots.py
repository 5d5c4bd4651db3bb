"""``robot new`` and ``robot show`` on the command line."""

import subprocess
import sys
from pathlib import Path

import matplotlib.image
import pytest
from typer.testing import CliRunner

from harness.places import ROBOTS
from tests.conftest import Valorctl
from valor.robot.description import RobotDescription
from valor.robot_setup.skeleton import find_skeleton
from valor.robot_setup.source import Question, Source
from valor.valorctl.terminal.app import app

VALORCTL = Path(sys.executable).with_name("valorctl")
MODEL = ROBOTS / "escher" / "model.xml"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_model_becomes_a_valid_folder(here: Path, valorctl: Valorctl) -> None:
    status, reported, _ = valorctl("robot", "new", str(MODEL), "--name", "mine", "--yes")
    assert status == 0
    for words in ("mine: 38 joints, 75.9 kg", "l_knee_pitch, r_knee_pitch", " × 14.9 cm"):
        assert words in reported
    assert reported.endswith(
        "Next:\n  valorctl robot check mine\n  valorctl robot get-up mine\n  valorctl up --robot mine\n"
    )
    assert sorted(file.name for file in here.iterdir()) == ["mine"]
    assert {"model.xml", "robot.yaml"} <= {file.name for file in (here / "mine").iterdir()}
    assert RobotDescription.load(here / "mine").name == "mine"


def test_a_folder_is_replaced_only_with_force(here: Path, valorctl: Valorctl) -> None:
    (here / "mine").mkdir()
    (here / "mine" / "notes").touch()
    new = ("robot", "new", str(MODEL), "--name", "mine", "--yes")
    status, _, err = valorctl(*new)
    assert status == 1 and "exists; expected another --out" in err
    status, _, err = valorctl(*new, "--force")
    assert status == 1 and "robots' folders only" in err
    (here / "mine" / "robot.yaml").touch()
    assert valorctl(*new, "--force")[0] == 0
    assert not (here / "mine" / "notes").exists()
    status, _, err = valorctl("robot", "new", "mine/model.xml", "--name", "mine", "--yes", "--force")
    assert status == 1 and "contains the source" in err
    assert sorted(file.name for file in here.iterdir()) == ["mine"]


def test_motions_of_getting_up_are_not_replaced_without_force(valorctl: Valorctl) -> None:
    status, _, err = valorctl("robot", "get-up", "escher")
    assert status == 1 and "get_up.yaml: exists; expected a robot without, or --force to replace it" in err


@pytest.mark.parametrize(
    ("content", "words"), [(None, "expected a file, MJCF or URDF"), ("<mujoco><worl", "XML parse error")]
)
def test_an_unsuitable_model_is_rejected(content: str | None, words: str, here: Path, valorctl: Valorctl) -> None:
    before = []
    if content is not None:
        (here / "a.xml").write_text(content)
        before = ["a.xml"]
    status, _, err = valorctl("robot", "new", "a.xml", "--name", "mine", "--yes")
    assert status == 1
    assert err.startswith("valorctl: a.xml: ") and words in err and err.count("\n") == 1
    assert sorted(file.name for file in here.iterdir()) == before


def test_the_name_is_asked_for(here: Path) -> None:
    answered = CliRunner().invoke(app, ["robot", "new", str(MODEL)], input="other\n")
    assert answered.exit_code == 0, answered.output
    assert "name of the robot [escher]" in answered.output
    assert (here / "other" / "robot.yaml").is_file()


def test_a_question_without_an_answer_is_reported_in_one_line(here: Path) -> None:
    reported = subprocess.run(
        [VALORCTL, "robot", "new", MODEL], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert (reported.returncode, reported.stderr) == (
        1,
        "valorctl: name of the robot: no answer; expected one, or --yes\n",
    )
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

    source = Source(file, ask)
    found = find_skeleton(source)
    return questions, source, {side: [found.joint_name(j) for j in leg.joints] for side, leg in found.legs.items()}


@pytest.mark.parametrize(("answer", "first"), [("feet", "r_hip_yaw"), ("names", "l_hip_yaw")])
def test_names_that_contradict_the_feet_cause_a_question(answer: str, first: str, tmp_path: Path) -> None:
    swapped = MODEL.read_text().replace('name="l_', 'name="x_').replace('name="r_', 'name="l_')
    before, _, contact = swapped.replace('name="x_', 'name="r_').partition("<contact>")  # which names bodies
    content = before + contact.partition("</contact>")[2]
    questions, source, legs = asked_of(content, tmp_path, {"names of left": answer})
    assert [question.choices for question in questions] == [("feet", "names")]
    assert legs["left"][0] == first
    assert any("contradict" in note for note in source.notes)


def test_an_undriven_joint_causes_a_question(tmp_path: Path) -> None:
    driven = [name for name in RobotDescription.load(ROBOTS / "escher").joints if name != "neck_yaw"]
    motors = "".join(f'<motor joint="{name}"/>' for name in driven)
    model = MODEL.read_text().replace("</mujoco>", f"<actuator>{motors}</actuator></mujoco>")
    questions, _, _ = asked_of(model, tmp_path, {})
    assert len(questions) == 1 and "neck_yaw" in questions[0].text and questions[0].guess == "weld"
    file = tmp_path / "a.xml"
    assert list(find_skeleton(Source(file)).passive.hinges.values()) == [False]
    assert find_skeleton(Source(file, lambda question: "servo")).passive.hinges == {}


def test_the_picture_shows_the_robot(here: Path, valorctl: Valorctl) -> None:
    assert valorctl("robot", "show", "escher")[0] == 0
    image = matplotlib.image.imread(here / "escher.png")[:, :, :3]
    width = image.shape[1]
    for part in (image[:, : width // 4], image[:, width // 2 :]):
        assert part.std() > 0.05
    blue = (image[:, width // 4 : width // 2, 2] - image[:, width // 4 : width // 2, 0]) > 0.15
    assert blue.mean() > 0.02  # what touches
    (here / "file").touch()
    status, _, err = valorctl("robot", "show", "escher", "--out", "file/a.png")
    assert status == 1 and err.startswith("valorctl: file/a.png: ") and err.count("\n") == 1
