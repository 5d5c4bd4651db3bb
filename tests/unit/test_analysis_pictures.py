"""Pictures show the robot, and show that it moved; plots show every joint."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from harness import analysis_bag
from harness.places import REPOSITORY, ROBOTS
from valor.analysis import pictures, plots
from valor.analysis.bag import Bag
from valor.bags.errors import BagError
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Bag:
    path = tmp_path_factory.mktemp("bag") / "reach.mcap"
    analysis_bag.write(path, ROBOT)
    return Bag(path)


def read(path: Path) -> np.ndarray:
    """(height, width, 3), 0 to 1."""
    return np.asarray(matplotlib.image.imread(path))[:, :, :3]


def panels(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The two pictures in a file, without the line between them."""
    width, height = pictures.PANEL
    image = read(path)[-height:]
    return image[:, 8 : width - 8], image[:, width + 8 : 2 * width - 8]


def test_before_and_after_differ_where_the_arm_moved(bag: Bag, tmp_path: Path) -> None:
    (path,) = pictures.render_before_after(bag, ROBOT, tmp_path / "out")
    image = read(path)
    width, height = pictures.PANEL
    assert image.shape[1] == 2 * width
    assert image.shape[0] > height
    before, after = panels(path)
    for panel in (before, after):
        assert panel.std() > 0.1  # a robot, not a wall
    moved = np.abs(before - after).max(axis=2) > 0.1
    assert 0.01 < moved.mean() < 0.5  # an arm and a head, not the world
    assert not moved[: height // 12].any()  # the sky


def test_the_same_moment_twice_gives_the_same_picture_twice(bag: Bag, tmp_path: Path) -> None:
    (path,) = pictures.render_before_after(bag, ROBOT, tmp_path, times=(3.0, 3.0))
    np.testing.assert_array_equal(*panels(path))


def test_without_manipulation_there_is_no_before_and_after(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(analysis_bag, "STAND", 100.0)
    monkeypatch.setattr(analysis_bag, "END", 0.5)
    analysis_bag.write(tmp_path / "still.mcap", ROBOT)
    with pytest.raises(BagError, match=r"still\.mcap: the robot was never in a manipulate behavior"):
        pictures.render_before_after(tmp_path / "still.mcap", ROBOT, tmp_path)


def test_without_opengl_the_error_says_what_to_install(bag: Bag, tmp_path: Path) -> None:
    program = (
        "import sys; from pathlib import Path\n"
        "from valor.analysis import pictures; from valor.drawing.errors import RenderingError\n"
        "from valor.robot.description import RobotDescription\n"
        "robot = RobotDescription.load(Path(sys.argv[2]))\n"
        "try: pictures.render_before_after(Path(sys.argv[1]), robot, Path(sys.argv[3]))\n"
        "except RenderingError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(bag.path), str(ROBOT.folder), str(tmp_path)],
        env=os.environ | {"MUJOCO_GL": "egl", "PYOPENGL_PLATFORM": "none-such"},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    said = done.stdout.partition(";")[0].strip()
    assert said and f"`{said}`" in (REPOSITORY / "README.md").read_text()
    assert done.stdout.count("\n") == 1


def test_joint_tracking_draws_each_group(bag: Bag, tmp_path: Path) -> None:
    paths = plots.joint_tracking(bag, ROBOT, ["right_arm", "neck"], tmp_path / "deep" / "out")
    assert [path.name for path in paths] == ["joint_tracking_right_arm.png", "joint_tracking_neck.png"]
    arm, neck = (read(path) for path in paths)
    assert arm.shape[1] == neck.shape[1]
    assert arm.shape[0] > neck.shape[0]  # seven joints take more rows than two
    for image in (arm, neck):
        for color in ((0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00)):  # command and measurement
            assert (np.abs(image - np.array(color) / 255).max(axis=2) < 0.02).sum() > 500


def test_an_unknown_group_is_named_with_those_that_are_there(bag: Bag, tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"no joint group 'third_arm'; it has left_leg, .*neck"):
        plots.joint_tracking(bag, ROBOT, ["third_arm"], tmp_path)


def test_balance_is_drawn(bag: Bag, tmp_path: Path) -> None:
    (path,) = plots.balance(bag, ROBOT, tmp_path)
    assert read(path).std() > 0.02
