"""Limbs are frozen while the rest of the robot goes on, and nothing jumps then or later."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bifrost import Received
from harness.dancer import JOINTS, ROBOT, Dancer
from harness.examples import examples
from valor.common.behaviors import LIMBS, Behavior
from valor.common.messages import HandGoal, JointGains
from valor.motion_manager.handlers.motion import HandGoalHandler
from valor.motion_manager.handlers.tuning import JointGainsHandler

MOVED = 0.03  # largest motion of a frozen joint at rest [rad]


@pytest.mark.parametrize("path", [[Behavior.STAND_MANIPULATE], [Behavior.WALK, Behavior.WALK_MANIPULATE]])
def test_whatever_is_frozen_stays_and_the_rest_goes_on(path: list[Behavior]) -> None:
    dancer = Dancer(*path)
    dancer.run(2.0)
    most = 1.5 * dancer.watch(3.2)[:, 1].max(axis=0) + 0.01

    @examples(3)
    @given(st.sets(st.sampled_from(LIMBS), min_size=1), st.floats(0.01, 3.0))
    def goes_on(limbs: set[str], after: float) -> None:
        before, x = dancer.watch(after), dancer.plant.data.qpos[0]
        assert dancer.freeze(*limbs).accepted
        braking, rest = dancer.watch(0.5), dancer.watch(1.5)
        frozen = np.concatenate([JOINTS[limb] for limb in limbs])
        others = np.setdiff1d(np.concatenate(list(JOINTS.values())), frozen)
        assert np.ptp(rest[:, 0, frozen], axis=0).max() < MOVED
        assert (rest[:, 1, others] < most[others]).all()
        assert dancer.freeze("none").accepted
        after_all = dancer.watch(1.0)
        commanded = np.concatenate((before, braking, rest, after_all))[:, 2]
        assert (np.abs(np.diff(commanded, axis=0)) <= ROBOT.velocity_limit * ROBOT.control_period + 1e-9).all()
        assert (after_all[-1, 1] < most).all(), "a released limb does not follow"
        assert dancer.behavior is path[-1] and (len(path) == 1 or dancer.plant.data.qpos[0] - x > 0.6)

    goes_on()


def test_what_is_refused_is_told_why() -> None:
    dancer = Dancer()  # in Stand
    components = dancer.manager.components
    for limbs, words in ((["left_arm", "left_leg"], "the legs carry the robot"), ([""], "expected of torso, left")):
        assert words in dancer.freeze(*limbs).reason
    assert "by freeze" in dancer.freeze("neck", behavior="stand").reason
    assert dancer.freeze("left_arm", "neck").accepted and dancer.manager.report().left_arm == "frozen"
    assert not dancer.ask(Behavior.STAND_MANIPULATE)
    dancer.run(0.1)
    heard = (0, 1, "a client")
    goal = Received(HandGoal(0, 0, True, "pelvis", np.zeros(3), np.zeros(4)), *heard)
    gains = Received(JointGains(ROBOT.tables.groups["left_arm"], np.ones(7), np.ones(7)), *heard)
    for handle in (
        partial(dancer.setpoints.handle, Received(dancer.setpoint("left_arm"), *heard)),
        partial(HandGoalHandler(components).handle, goal),
        partial(JointGainsHandler(components).handle, gains),
    ):
        components.rejections.take()
        assert not handle(dancer.manager.time)
        assert components.rejections.take()[-1].reason == "left_arm is frozen"
    # In Stand the other arm moves home, and this one once it is released.
    left, right = JOINTS["left_arm"], JOINTS["right_arm"]
    assert dancer.freeze("none").accepted
    dancer.run(1.0)
    assert dancer.freeze("left_arm").accepted and not dancer.ask(Behavior.STAND)
    away = np.abs(dancer.watch(3.0)[-1, 0] - ROBOT.nominal_posture)
    assert away[right].max() < 0.02 < 0.1 < away[left].max()
    assert dancer.freeze("none").accepted
    assert np.abs(dancer.watch(3.0)[-1, 0] - ROBOT.nominal_posture)[left].max() < 0.02
    assert dancer.freeze("left_arm").accepted and not dancer.ask(Behavior.FREEZE)  # of the whole robot
    dancer.run(0.1)
    assert components.upper_body.frozen == () and not components.reference.frozen.any()
    assert "it is in behavior freeze" in dancer.freeze("left_arm").reason
