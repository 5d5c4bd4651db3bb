"""The worlds: the ground that was asked for, where it was asked for, and the same from the same seed."""

import numpy as np
import pytest

from harness.places import ROBOTS
from valor.common.errors import ConfigurationError
from valor.robot.description import RobotDescription
from valor.simulation import worlds
from valor.simulation.plant import Plant
from valor.simulation.worlds.courses import Dirt, Stairs

ROBOT = RobotDescription.load(ROBOTS / "escher")
_dirt = worlds.WORLDS["dirt"]
assert isinstance(_dirt, Dirt)
DIRT = _dirt


@pytest.mark.parametrize("name", worlds.WORLDS)
def test_name_and_seed_say_everything(name: str) -> None:
    first, again, other = (worlds.load(name, seed).to_xml() for seed in (3, 3, 4))
    assert first == again and (first == other) == (name in ("flat", "stairs", "stairs_15cm"))


@pytest.mark.parametrize("name", worlds.WORLDS)
def test_the_robot_stands_on_level_ground_at_the_start(name: str) -> None:
    x, y = np.linspace(-0.5, 0.45, 20), np.linspace(-0.5, 0.5, 20)
    np.testing.assert_allclose(worlds.heights(name, 1, x, y), 0.0, atol=1e-6)
    robot = Plant(ROBOT, name, "ideal", 1)
    robot.actuators.hold(ROBOT.nominal_posture)
    robot.step(300)
    soles = [robot.model.site(foot.sole) for foot in (ROBOT.tables.feet.left, ROBOT.tables.feet.right)]
    np.testing.assert_allclose(robot.data.site_xpos[soles, 2], 0.0, atol=1e-3)


@pytest.mark.parametrize(("name", "rise"), [("stairs", 0.10), ("stairs_15cm", 0.15)])
def test_stairs_lead_up_and_down_where_the_table_states(name: str, rise: float) -> None:
    stairs = worlds.WORLDS[name]
    assert isinstance(stairs, Stairs) and stairs.up == pytest.approx([0.5, 0.8, 1.1])
    assert stairs.down == pytest.approx([2.3, 2.6, 2.9])
    edges = np.array([*stairs.up, *stairs.down])
    levels = rise * np.array([1, 2, 3, 2, 1, 0])
    y = np.linspace(-0.99, 0.99, 5)
    after, before = (worlds.heights(name, 0, edges + shift, y) for shift in (0.01, -0.01))
    np.testing.assert_allclose(after, np.tile(levels, (5, 1)), atol=1e-6)
    np.testing.assert_allclose(before, np.tile([0, *levels[:-1]], (5, 1)), atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_the_dirt_has_slopes_of_five_degrees_and_bumps_of_two_centimetres(seed: int) -> None:
    rng = np.random.default_rng(seed)
    along_y, along_x = np.gradient(DIRT.slopes(rng), DIRT.resolution)
    steepness = np.degrees(np.arctan(np.hypot(along_x, along_y)))
    assert steepness.max() <= DIRT.slope + 0.05
    on_course = (DIRT.x > 0) & (DIRT.x < DIRT.course)
    near = np.abs(DIRT.y) < 1.0
    assert (steepness[np.ix_(near, on_course)] > 4.5).mean() > 0.2, "patches, not a point"
    bumps = DIRT.bumps(rng)
    rough = bumps[:, DIRT.x > 1.6]
    assert 0.015 < np.abs(rough).max() <= 0.02 and 0.006 < rough.std() < 0.010
    assert not bumps[:, np.abs(DIRT.x) < 0.6].any()


def test_the_dirt_reaches_beyond_the_finish_and_the_physics_sees_the_generators_heights() -> None:
    assert DIRT.course == 61.0 and DIRT.x[-1] >= 65.0 and abs(DIRT.y[0]) >= 3.0
    rng = np.random.default_rng([7, 2])
    made = DIRT.slopes(rng) + DIRT.bumps(rng)
    columns, rows = np.arange(60, 1300, 77), np.arange(20, 140, 31)
    met = worlds.heights("dirt", 7, DIRT.x[columns], DIRT.y[rows])
    np.testing.assert_allclose(met, made[np.ix_(rows, columns)], atol=2e-4)


@pytest.mark.parametrize("seed", range(3))
def test_the_rubble_is_up_to_four_centimetres_high_and_begins_beyond_the_toes(seed: int) -> None:
    x, y = np.linspace(0.7, 3.2, 120), np.linspace(-0.5, 0.5, 50)
    met = worlds.heights("rubble", seed, x, y)
    assert met.min() >= 0.0 and 0.035 < met.max() <= 0.04 and 0.6 < (met > 0.002).mean() < 0.99
    before = worlds.heights("rubble", seed, np.linspace(0.0, 0.59, 40), y)
    np.testing.assert_allclose(before, 0.0, atol=1e-6)


def test_bumps_and_boxes_go_by_the_robots_legs_and_the_rest_does_not() -> None:
    thor = RobotDescription.load(ROBOTS / "thor")
    size = worlds.size_of(thor)
    assert worlds.size_of(ROBOT) == 1.0
    assert size == pytest.approx(thor.tables.size.leg / 0.82)
    y = np.linspace(-0.81, 0.77, 9)
    x = np.linspace(2.013, 3.019, 40)  # before the first slope, and beside the grid, between whose cells rays slip
    for name, places in (("dirt", x), ("rubble", x - 0.7)):
        theirs, ours = (worlds.heights(name, 5, places, y, each) for each in (size, 1.0))
        np.testing.assert_allclose(theirs, size * ours, atol=2e-4)
    assert worlds.load("stairs", 0, 0.3).to_xml() == worlds.load("stairs", 0).to_xml()
    rng = np.random.default_rng([5, 2])
    met = np.ptp(DIRT.slopes(rng) + size * DIRT.bumps(rng))
    assert Plant(thor, "dirt", "ideal", 5).model.mj.hfield_size[0, 2] == pytest.approx(met, rel=1e-3)


def test_an_unknown_world_is_rejected_by_name() -> None:
    with pytest.raises(ConfigurationError, match=r"world '\.\./worlds/flat'"):
        worlds.load("../worlds/flat", 0)
