"""Previews of goals and steps, the shapes that show them, clicks on the robot, and the simulated world."""

import math
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
from viser import ViserServer

from harness.closed_loop import load_robot
from valor.common.errors import ValorError
from valor.common.poses import level, middle
from valor.operator_station.scene import shapes
from valor.operator_station.scene.body import Body
from valor.operator_station.scene.footfalls import faults, floor_point, sole_poses, walk_to
from valor.operator_station.scene.overlays import force_arrow
from valor.operator_station.scene.scene import Surroundings, local_poses, moving
from valor.operator_station.tabs.preview import Previewer
from valor.robot.model import full_model
from valor.simulation import worlds

ROBOT = load_robot("escher")
BOTH = (True, True)
UP_AHEAD = np.array((0.06, 0.0, 0.05))
OPEN = np.array([0.7, 0.2])  # of the door's leaf and lever [rad]


@pytest.fixture(scope="module")
def body() -> Body:
    return Body(full_model(ROBOT, "collision"))


@pytest.fixture(scope="module")
def previewer() -> Previewer:
    return Previewer(full_model(ROBOT, "collision"))


@pytest.mark.parametrize("name", sorted(ROBOT.tables.arm_presets))
def test_the_robots_own_presets_are_not_refused(name: str, body: Body, previewer: Previewer) -> None:
    for goal in ROBOT.tables.arm_presets[name].values():
        assert previewer.arm(body, goal, BOTH).faults == []


def test_limits_collisions_and_balance_are_reported(body: Body, previewer: Previewer) -> None:
    joint = ROBOT.tables.group("right_arm")[0]
    beyond = float(ROBOT.upper[ROBOT.index[joint]]) + 0.1
    assert previewer.arm(body, {joint: beyond}, BOTH).faults[0].startswith(f"limits: {joint}")
    assert "balance" in previewer.arm(body, {joint: 0.0}, (False, False)).faults[-1]
    roll = next(name for name in ROBOT.tables.group("right_arm") if name.endswith("shoulder_roll"))
    ends = (ROBOT.lower[ROBOT.index[roll]], ROBOT.upper[ROBOT.index[roll]])
    inward = max(ends, key=lambda angle: _through(previewer, body, roll, float(angle)))
    assert _through(previewer, body, roll, float(inward)), "an arm that is turned through the body collides with it"


def _through(previewer: Previewer, body: Body, joint: str, angle: float) -> bool:
    return any("would touch" in fault for fault in previewer.arm(body, {joint: 0.98 * angle}, BOTH).faults)


def test_a_hand_reaches_what_is_near_and_not_what_is_far(body: Body, previewer: Previewer) -> None:
    hand = ROBOT.tables.hands.right
    assert hand is not None
    position, turn = body.site(hand.site)
    near = previewer.hand(body, "right", position + UP_AHEAD, turn, BOTH)
    assert near.faults == []
    moved = Body(body.model)
    moved.bend(near.joints)
    moved.update()
    np.testing.assert_allclose(moved.site(hand.site)[0], position + UP_AHEAD, atol=0.01)
    far = previewer.hand(body, "right", position + 30.0 * UP_AHEAD, turn, BOTH)
    assert far.faults[0].startswith("reach: the right hand would stay")


def test_clicks_that_lead_nowhere(body: Body) -> None:
    soles = sole_poses(body.soles())
    assert floor_point((0.0, 0.0, 2.0), (1.0, 0.0, 0.0), 0.0) is None
    assert floor_point((0.0, 0.0, -1.0), (0.0, 0.0, -1.0), 0.0) is None
    with pytest.raises(ValorError, match="there already"):
        walk_to(ROBOT, soles, middle(*soles).position[:2])
    with pytest.raises(ValorError, match="exceeds a plan"):
        walk_to(ROBOT, soles, (1000.0, 0.0))
    assert "forward of the other foot" in faults(ROBOT, soles, [(0, level(2.0, 0.1, 0.0, 0.0))])[0]


def test_frames_in_their_parents_make_the_whole(body: Body) -> None:
    moved = Body(body.model)
    moved.place((0.3, -0.2, 1.0), (0.5, 0.5, 0.5, 0.5))
    moved.pose(np.clip(np.linspace(-0.5, 0.5, len(ROBOT.joints)), ROBOT.lower, ROBOT.upper))
    moved.update()
    parents = np.array(body.model.mj.body_parentid)
    positions, orientations = local_poses(moved, parents)
    data = moved.data
    for number, (position, orientation) in enumerate(zip(positions, orientations, strict=True), start=1):
        mother = parents[number]
        place, turn = np.zeros(3), np.zeros(4)
        mujoco.mju_mulPose(place, turn, data.xpos[mother], data.xquat[mother], position, orientation)
        np.testing.assert_allclose(place, moved.data.xpos[number], atol=1e-9)
        assert abs(float(turn @ moved.data.xquat[number])) == pytest.approx(1.0)


def test_a_force_starts_at_the_centre_of_pressure() -> None:
    wrench = np.array((0.0, 0.0, 400.0, 400.0 * 0.02, -400.0 * 0.05, 0.0))
    arrow = force_arrow(wrench, np.array((1.0, 2.0, 0.0)), np.eye(3))
    np.testing.assert_allclose(arrow[0], (1.05, 2.02, 0.0))
    np.testing.assert_allclose(arrow[1] - arrow[0], (0.0, 0.0, 0.4))


@pytest.fixture(scope="module")
def whole() -> Body:
    return Body(full_model(ROBOT, "all"))


def test_every_shape_of_the_robot_is_drawn(whole: Body) -> None:
    model = whole.model.mj
    drawn = {number for number in range(1, model.nbody) if shapes.of_body(model, number)}
    assert drawn == {int(body) for body in model.geom_bodyid} - {0}


@pytest.fixture
def server() -> Iterator[ViserServer]:
    server = ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.mark.parametrize(("world", "bodies"), [("door", 2), ("valve", 1), ("flat", 0), ("stairs", 0)])
def test_what_turns_in_a_world_is_drawn_beside_what_does_not(world: str, bodies: int) -> None:
    model = worlds.load(world, 1).compile()
    assert len(moving(model)) == bodies
    assert all(shapes.of_body(model, body) for body in moving(model))
    still = shapes.of_world(model)
    assert bool(still) == (world != "flat"), "a plane is drawn by the page"
    assert all(mesh.faces.max() < len(mesh.vertices) for mesh in still)


def test_a_door_is_drawn_as_far_open_as_it_is(server: ViserServer) -> None:
    model = worlds.load("door", 1).compile()
    surroundings = Surroundings(server.scene, model)
    data = mujoco.MjData(model)
    leaf, lever = moving(model)

    def check(positions: np.ndarray) -> None:
        data.qpos[:] = positions
        mujoco.mj_kinematics(model, data)
        for body in (leaf, lever):
            np.testing.assert_allclose(surroundings.frames[body].position, data.xpos[body], atol=1e-9)
            np.testing.assert_allclose(surroundings.frames[body].wxyz, data.xquat[body], atol=1e-9)

    check(np.zeros(2))
    shut = np.array(surroundings.frames[leaf].wxyz)
    surroundings.turn(OPEN)
    check(OPEN)
    assert 2.0 * math.acos(min(1.0, abs(float(shut @ surroundings.frames[leaf].wxyz)))) == pytest.approx(OPEN[0])
    surroundings.turn(np.zeros(0))
    surroundings.turn(np.zeros(3))
    check(OPEN)


def test_foxglove_draws_the_same_fixtures() -> None:
    pytest.importorskip("foxglove")
    from valor.common.instance import Settings
    from valor.foxglove_bridge.world import World

    door = World(Settings(robot=ROBOT.folder, ros_domain_id=1, world="door", seed=1), ROBOT)
    shut, opened = door.fixtures("odom", np.zeros(2)), door.fixtures("odom", OPEN)
    assert repr(shut) != repr(opened), "it is somewhere else"
    assert repr(shut).count("CubePrimitive") == repr(opened).count("CubePrimitive") >= 1
    assert door.fixtures("odom", np.zeros(1)) is None
