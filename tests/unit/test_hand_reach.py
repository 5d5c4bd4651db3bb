"""Hands get to whatever pose the joints' limits allow, also where the straight way ends in a corner of them."""

from typing import cast

import numpy as np
import pytest

from harness.closed_loop import load_robot
from valor.common.arrays import FloatArray
from valor.control.state import RobotState
from valor.motion_manager.hands.goal_stream import HandGoal
from valor.motion_manager.hands.hand_goals import SIDES, HandGoals
from valor.motion_manager.joints.joint_reference import JointReference
from valor.robot.model import controller_model, full_model

ROBOT = load_robot()
MODEL = controller_model(ROBOT)
GOALS = 20
INSIDE = 0.15  # of the joints' limits [rad]
LONGEST = 25.0  # [s]
UNMOVED = cast("RobotState", None)  # goals in pelvis need no estimate


class Arms:
    """Led without a plant: joints are where they are commanded."""

    def __init__(self) -> None:
        self.reference = JointReference(ROBOT)
        self.reference.take_up(np.ones(len(ROBOT.joints), dtype=bool), ROBOT.nominal_posture)
        self.goals = HandGoals(MODEL, self.reference, ROBOT.nominal_posture)
        self.now = 0.0

    def go(self, side: int, place: FloatArray, turn: FloatArray) -> str:
        """The state that a hand ends in."""
        self.goals.start(side, HandGoal(False, place, turn), self.now)
        until = self.now + LONGEST
        while self.now < until and self.goals.status(side, 0).state == "moving":
            self.now += ROBOT.control_period
            self.goals.advance(UNMOVED, self.reference.position, self.now, ROBOT.control_period)
            self.reference.advance(self.now, ROBOT.control_period)
        return self.goals.status(side, 0).state


def reachable(side: int) -> list[tuple[FloatArray, FloatArray]]:
    """Where postures within the limits have the hand, beside the body."""
    from mujoco import MjData, mj_kinematics

    model, rng = full_model(ROBOT), np.random.default_rng(20)
    data, arm = MjData(model.mj), ROBOT.group_indices(f"{SIDES[side]}_arm")
    hand = ROBOT.tables.hands.right if side else ROBOT.tables.hands.left
    assert hand is not None
    site, places = model.site(hand.site), np.arange(model.mj.nq)[model.qpos][arm]
    out = list[tuple[FloatArray, FloatArray]]()
    while len(out) < GOALS:
        data.qpos[:] = model.nominal_qpos()
        data.qpos[:3] = 0.0
        data.qpos[places] = rng.uniform(ROBOT.lower[arm] + INSIDE, ROBOT.upper[arm] - INSIDE)
        mj_kinematics(model.mj, data)
        place = data.site_xpos[site]
        if place[1] * (1 - 2 * side) > 0.25 and -0.35 < place[2] < 0.8:
            out.append((place.copy(), data.site_xmat[site].reshape(3, 3).copy()))
    return out


@pytest.mark.parametrize("side", [0, 1])
def test_hands_reach_the_poses_of_random_postures(side: int) -> None:
    """Straight, two thirds of them are reached: of the others most lie behind a joint's limit."""
    arms = Arms()
    states = [arms.go(side, *pose) for pose in reachable(side)]
    assert states.count("reached") >= GOALS - 1, states
