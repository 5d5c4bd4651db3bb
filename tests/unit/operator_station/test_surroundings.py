"""What turns in the simulated world is drawn as far as it is turned."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from viser import ViserServer

from bifrost import Message
from harness import analysis_bag
from harness.places import ROBOTS
from valor.analysis.bag import Bag
from valor.analysis.recording import Recording
from valor.common.messages import GroundTruth
from valor.common.topics import GROUND_TRUTH, Topic
from valor.operator_station import shapes
from valor.operator_station.intake import Intake
from valor.operator_station.player import Player, wanted_of
from valor.operator_station.surroundings import Surroundings, moving
from valor.operator_station.tape import Tape
from valor.robot.description import RobotDescription
from valor.simulation import worlds

ROBOT = RobotDescription.load(ROBOTS / "escher")
OPEN = np.array([0.7, 0.2])  # of the door's leaf and lever [rad]


@pytest.fixture
def server() -> Iterator[ViserServer]:
    server = ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """In which the door opens by 0.7 rad in 2 s."""
    path = tmp_path_factory.mktemp("door") / "door.mcap"

    def messages() -> Iterator[tuple[Topic[Any], Message]]:
        for topic, message in analysis_bag.simulate(ROBOT):
            if isinstance(message, GroundTruth):
                message.fixture_position = OPEN * min(1.0, 1e-9 * message.time / 2.0)
            yield topic, message

    analysis_bag.write_messages(path, messages())
    return path


@pytest.mark.parametrize(("world", "bodies"), [("door", 2), ("valve", 1), ("flat", 0), ("stairs", 0)])
def test_what_turns_in_a_world_is_drawn_beside_what_does_not(world: str, bodies: int) -> None:
    model = worlds.load(world, 1).compile()
    assert len(moving(model)) == bodies
    assert all(shapes.of_body(model, body) for body in moving(model))
    still = shapes.of_world(model)
    assert bool(still) == (world != "flat"), "a plane is drawn by the page"


def test_a_door_is_drawn_as_far_open_as_it_is(server: ViserServer) -> None:
    model = worlds.load("door", 1).compile()
    surroundings = Surroundings(server.scene, model)
    data = mujoco.MjData(model)
    leaf, lever = moving(model)

    def drawn(body: int) -> tuple[np.ndarray, np.ndarray]:
        frame = surroundings.frames[body]
        return np.array(frame.position), np.array(frame.wxyz)

    def check(positions: np.ndarray) -> None:
        data.qpos[:] = positions
        mujoco.mj_kinematics(model, data)
        for body in (leaf, lever):
            np.testing.assert_allclose(drawn(body)[0], data.xpos[body], atol=1e-9)
            np.testing.assert_allclose(drawn(body)[1], data.xquat[body], atol=1e-9)

    check(np.zeros(2))
    shut = drawn(leaf)[1]
    surroundings.turn(OPEN)
    check(OPEN)
    assert 2.0 * math.acos(min(1.0, abs(float(shut @ drawn(leaf)[1])))) == pytest.approx(OPEN[0])
    surroundings.turn(np.zeros(0))
    surroundings.turn(np.zeros(3))
    check(OPEN)


def test_a_recording_says_how_far_it_was_open(bag: Path) -> None:
    recording = Recording(Bag(bag), ROBOT)
    for seconds in (0.5, 1.5, 3.0):
        at = recording.posture(seconds)
        np.testing.assert_allclose(at.fixture_position, OPEN * min(1.0, seconds / 2.0), atol=0.01)
    assert recording.has(GROUND_TRUTH)


def test_the_page_plays_it(bag: Path) -> None:
    intake = Intake(recorded=True)
    tape = Tape(bag, wanted_of(intake))
    try:
        tape._thread.join()
        player = Player(tape, intake)
        player.seek(player.length)
        np.testing.assert_allclose(intake.heard.fixtures, OPEN, atol=0.01)
        player.seek(0.0)
        assert intake.heard.fixtures.size in (0, 2) and not intake.heard.fixtures.any()
    finally:
        tape.close()


def test_foxglove_is_told_likewise() -> None:
    pytest.importorskip("foxglove")
    from valor.common.instance import Settings
    from valor.foxglove_bridge.world import World

    door = World(Settings(robot=ROBOT.folder, ros_domain_id=1, world="door", seed=1), ROBOT)
    ground, shut, opened = door.ground("odom"), door.fixtures("odom", np.zeros(2)), door.fixtures("odom", OPEN)
    assert "CubePrimitive" in repr(ground) and 'id="world"' in repr(ground)
    assert 'id="fixtures"' in repr(opened) and 'frame_id="odom"' in repr(opened)
    assert repr(shut) != repr(opened), "it is somewhere else"
    assert repr(shut).count("CubePrimitive") == repr(opened).count("CubePrimitive") >= 1
    assert door.fixtures("odom", np.zeros(1)) is None
    flat = World(Settings(robot=ROBOT.folder, ros_domain_id=1), ROBOT)
    assert flat.fixtures("odom", np.zeros(0)) is None and "CubePrimitive" in repr(flat.ground("odom"))
