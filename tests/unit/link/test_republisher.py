"""What the operator's end makes of a state: the three machines of Table 3.1 by the behavior, and no number made up."""

import math

import numpy as np
import pytest

from valor.common.behaviors import INTERNAL_STATES, REFLEX, Behavior
from valor.link.state import RobotState
from valor.link_operator.republisher import motion_state


@pytest.mark.parametrize("behavior", Behavior)
def test_the_machines_are_those_of_the_behavior(behavior: Behavior) -> None:
    told = motion_state(RobotState(joints=np.zeros(3), behavior=str(behavior), stamp=1234, contacts=2))
    assert (told.locomotion, told.manipulation, told.attention) == INTERNAL_STATES[behavior]
    assert told.time == 1_234_000_000 and list(told.contacts) == [0, 1]


def test_what_the_link_does_not_carry_is_not_made_up() -> None:
    told = motion_state(RobotState(joints=np.zeros(3), behavior=REFLEX))
    assert (told.behavior, told.locomotion) == (REFLEX, "")
    assert math.isnan(told.tick_time) and told.qp_failures == -1 and not len(told.joint_setpoint)
