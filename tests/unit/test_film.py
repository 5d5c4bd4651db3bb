"""Films of recordings: what is seen in them, what they are refused for, and that none is left by half."""

import dataclasses
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from harness import analysis_bag
from harness.bag_file import type_store, write_bag
from harness.places import ROBOTS
from valor.analysis.film import film, moments
from valor.analysis.film.frames import CAMERAS, views
from valor.analysis.film.moments import TRUTH
from valor.common.errors import ValorError
from valor.common.poses import Pose
from valor.drawing import marks
from valor.robot.description import RobotDescription

FOLDER = ROBOTS / "escher"
ROBOT = RobotDescription.load(FOLDER)
SIZE = (160, 90)
VALORCTL = Path(sys.executable).with_name("valorctl")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "reach.mcap"
    analysis_bag.write(path, ROBOT)
    return path


def order(**changes: Any) -> film.FilmOptions:
    """A small film of a robot that the bag does not name."""
    return film.FilmOptions(**{"robot": FOLDER, "size": SIZE, "rate": 4.0, **changes})


def pictures(file: Path) -> list[np.ndarray]:
    """(height, width, 3) each, 0 to 255."""
    with av.open(str(file)) as opened:
        return [frame.to_ndarray(format="rgb24").astype(int) for frame in opened.decode(video=0)]


@pytest.mark.parametrize("suffix", [".mp4", ".webp"])
def test_a_film_shows_that_the_arm_moved(bag: Path, tmp_path: Path, suffix: str) -> None:
    reported: list[tuple[int, int]] = []
    made = film.make(
        bag, tmp_path / f"reach{suffix}", order(begin=1.0, end=3.0, overlays=("forces", "dcm", "modes")),
        drawn=lambda done, whole: reported.append((done, whole)),
    )  # fmt: skip
    assert (made.pictures, made.duration, made.base) == (9, 2.25, "the simulator's truth")
    assert reported == [(i + 1, 9) for i in range(9)]
    assert [path.name for path in tmp_path.iterdir()] == [made.file.name]
    if suffix == ".webp":  # libav writes what it does not read
        content = made.file.read_bytes()
        assert (content[:4], content[8:12], content.count(b"ANMF")) == (b"RIFF", b"WEBP", 9)
        return
    seen = pictures(made.file)
    assert len(seen) == 9 and seen[0].shape == (SIZE[1], SIZE[0], 3)
    changed = np.abs(seen[0] - seen[-1]).max(axis=2) > 60
    assert 0.002 < changed.mean() < 0.4  # an arm and a head, not the world


def test_a_door_is_drawn_as_far_open_as_it_was(bag: Path, tmp_path: Path) -> None:
    wanted = order(begin=1.0, end=1.3, camera="shoulder")
    seen = {}
    for name, leaf in (("closed", (0.0, 0.0)), ("open", (1.2, 0.0)), ("unknown", ())):
        found = moments.read(bag, 1.0, 1.3, 0.25, lambda seconds: None)
        for moment in found.known:
            moment[TRUTH] = dataclasses.replace(moment[TRUTH], fixture_position=np.array(leaf))
        file = tmp_path / f"{name}.mp4"
        film.develop(found, FOLDER, ("door", 0), file, wanted)
        seen[name] = pictures(file)[-1]
    assert (np.abs(seen["open"] - seen["closed"]).max(axis=2) > 40).mean() > 0.02
    assert (seen["unknown"] == seen["closed"]).all()


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"camera": "beside"}, "camera 'beside': expected one of follow, front"),
        ({"overlays": ("force",)}, "did you mean 'forces'"),
        ({"begin": 2.0, "end": 2.0}, "from 2 to 2 s: expected an end after"),
        ({"begin": -1.0}, "expected at least 0 s after the start"),
        ({"speed": 0.0}, "speed 0: expected"),
        ({"size": (161, 90)}, "size 161×90: expected even sides"),
        ({"rate": 0.0}, "expected 1 to 120"),
    ],
)
def test_what_cannot_be_filmed_is_named(changes: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValorError) as caught:
        order(**changes)
    assert complaint in str(caught.value)


def test_a_bag_that_is_none_ends_early_or_names_no_robot(bag: Path, tmp_path: Path) -> None:
    text = tmp_path / "text.mcap"
    text.write_text("no bag")
    for path, wanted, file, complaint in (
        (text, order(), "a.mp4", "not MCAP"),
        (bag, order(begin=900.0), "a.mp4", "nothing after 900 s; the recording lasts"),
        (bag, order(), "a.avi", "expected one of .mp4, .webp"),
        (bag, order(robot=None), "a.mp4", "names no robot; expected --robot"),
        (bag, order(robot=ROBOTS / "thor"), "a.mp4", "joints; robot 'thor' has"),
    ):
        with pytest.raises(ValorError, match=complaint.replace(".", r"\.")):
            film.make(path, tmp_path / "out" / file, wanted)
    assert not (tmp_path / "out").exists()


def test_ctrl_c_leaves_nothing(bag: Path, tmp_path: Path) -> None:
    command = [str(VALORCTL), "video", str(bag), "--robot", "escher", "--fps", "60", "--out", f"{tmp_path}/long.mp4"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None and "drawing" in run.stdout.readline()
        run.send_signal(signal.SIGINT)
        _, complaints = run.communicate(timeout=120.0)
    assert (run.returncode, complaints.strip()) == (130, "valorctl: interrupted by SIGINT")
    assert not list(tmp_path.iterdir())


def test_without_the_motion_system_ros_2s_own_topics_do(tmp_path: Path) -> None:
    path, store = tmp_path / "ros.mcap", type_store()
    kinds = store.types

    def rows() -> Iterator[tuple[int, str, str, Any]]:
        zeros = np.zeros(36)
        for i in range(40):
            header = kinds["std_msgs/msg/Header"](
                stamp=kinds["builtin_interfaces/msg/Time"](sec=7, nanosec=25_000_000 * i), frame_id="odom"
            )
            position = np.full(1, -0.01 * i)
            yield i, "/joint_states", "sensor_msgs/msg/JointState", kinds["sensor_msgs/msg/JointState"](
                header=header, name=["r_elbow_pitch"], position=position, velocity=position, effort=position
            )  # fmt: skip
            point = kinds["geometry_msgs/msg/Point"](x=0.1 * i, y=0.0, z=0.9)
            turn = kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
            still = kinds["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
            pose = kinds["geometry_msgs/msg/Pose"](position=point, orientation=turn)
            yield i, "/odom", "nav_msgs/msg/Odometry", kinds["nav_msgs/msg/Odometry"](
                header=header, child_frame_id="pelvis",
                pose=kinds["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=zeros),
                twist=kinds["geometry_msgs/msg/TwistWithCovariance"](
                    twist=kinds["geometry_msgs/msg/Twist"](linear=still, angular=still), covariance=zeros
                ),
            )  # fmt: skip

    write_bag(path, store, rows())
    made = film.make(path, tmp_path / "ros.mp4", order(camera="fixed"))
    assert (made.pictures, made.base) == (4, "the robot's estimate")
    found = moments.read(path, 0.5, None, 0.1, lambda seconds: None)
    assert found.times[0] == pytest.approx(7.5)
    assert [each["/odom"].pose.pose.position.x for each in found.known] == pytest.approx([2.0, 2.4, 2.8, 3.2, 3.6])


def test_a_camera_follows_and_one_does_not() -> None:
    places = np.column_stack([np.linspace(0.0, 4.0, 50), np.zeros(50), np.zeros(50)])
    follows, stays = (views(CAMERAS[name], places, 0.3, 1.8, 0.04) for name in ("follow", "fixed"))
    assert follows[-1].point[0] - follows[0].point[0] > 3.0
    assert {tuple(view.point.round(6)) for view in stays} == {(2.0, 0.0, 0.72)}
    assert stays[0].distance > follows[0].distance


def test_forces_stand_where_they_act_and_support_spans_what_stands() -> None:
    feet = ROBOT.tables.feet
    soles = (Pose((0.0, 0.1, 0.0)), Pose((0.0, -0.1, 0.0)))
    wrench = np.array([0.0, 0.0, 400.0, 4.0, -20.0, 0.0])
    (arrow,) = marks.forces(soles, np.stack([wrench, np.zeros(6)]))
    assert isinstance(arrow, marks.Arrow)
    np.testing.assert_allclose(arrow.start, (0.05, 0.11, 0.0))
    np.testing.assert_allclose(arrow.end - arrow.start, (0.0, 0.0, 0.4), atol=1e-12)
    (both,) = marks.support(soles, (True, True), feet)
    (one,) = marks.support(soles, (True, False), feet)
    assert isinstance(both, marks.Polyline) and isinstance(one, marks.Polyline)
    assert np.ptp(both.points[:, 1]) == pytest.approx(0.2 + feet.left.half_width + feet.right.half_width)
    assert np.ptp(one.points[:, 1]) == pytest.approx(2.0 * feet.left.half_width)
    assert marks.support(soles, (False, False), feet) == []
