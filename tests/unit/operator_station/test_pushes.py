"""Where a click meets the robot."""

import numpy as np
import pytest

from harness.closed_loop import load_robot
from valor.operator_station.body import Body
from valor.operator_station.simulation import hit
from valor.robot.model import full_model

ROBOT = load_robot("escher")


@pytest.fixture(scope="module")
def body() -> Body:
    return Body(full_model(ROBOT, "all"))


@pytest.mark.parametrize("name", [ROBOT.tables.chest, "l_hand", "r_foot"])
def test_what_one_clicks_on_is_what_is_pushed(name: str, body: Body) -> None:
    there = np.array(body.data.body(name).xipos)
    outwards = np.array((1.0, 0.0, 0.0)) if name == ROBOT.tables.chest else np.array((0.0, np.sign(there[1]), 0.0))
    met = hit(body, there + 3.0 * outwards, -2.0 * outwards)
    assert met is not None
    # From there the nearest of that limb is met, a finger of a hand perhaps.
    parents = body.model.mj.body_parentid
    number = body.model.mj.body(met).id
    chain = {met}
    while number:
        number = int(parents[number])
        chain.add(body.model.mj.body(number).name)
    assert name in chain or name == body.model.mj.body(parents[body.model.mj.body(met).id]).name


def test_a_click_beside_the_robot_pushes_nothing(body: Body) -> None:
    assert hit(body, np.array((3.0, 0.0, 3.0)), np.array((-1.0, 0.0, 0.0))) is None
    assert hit(body, np.array((3.0, 0.0, 1.0)), np.array((1.0, 0.0, 0.0))) is None, "behind the viewer"


def test_it_is_where_the_robot_is(body: Body) -> None:
    moved = Body(body.model)
    moved.like(body)
    moved.place((5.0, 0.0, body.data.qpos[2]), (1.0, 0.0, 0.0, 0.0))
    moved.update()
    at = np.array(body.data.body(ROBOT.tables.chest).xipos)
    left, across = np.array((0.0, 3.0, 0.0)), np.array((0.0, -1.0, 0.0))
    assert hit(moved, at + left, across) is None
    assert hit(moved, at + left + np.array((5.0, 0.0, 0.0)), across) is not None
