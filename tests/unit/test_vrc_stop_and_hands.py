"""Mode stop lets the hands go, also of goals that the Motion System has not heard or told of yet."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped

from harness.instance import RunningInstance
from tests.unit.test_vrc_who_has_the_arm import AT_ONCE, Arms
from valor.common.instance import Settings
from valor.ros.node import RosSide
from valor.valor_ros_controller.ros.controller_bypass import MAX_PER_CYCLE, ControllerBypass
from valor.valor_ros_controller.ros.node import CommandNode


class Hand(Arms):
    """A robot in stand_manipulate, whose right hand is led over ROS."""

    def __init__(self, side: RosSide) -> None:
        super().__init__()
        vrc = self.system.vrc
        frames = {"base_link": "pelvis"}
        network: Any = self.system.network
        bypass = ControllerBypass(side.node, network, vrc.interface, frames, soft_stop=lambda: None, choose=print)
        modes = vrc.mode_controller
        self.system.after = lambda: bypass.update(modes.current, vrc.hw, modes.stops)
        self._goals = next(each for each in side.node.subscriptions if each.topic_name.endswith("r_hand/goal_pose"))
        self.system.run(4)

    def goal(self) -> None:
        """One comes."""
        goal = PoseStamped()
        goal.header.frame_id = "base_link"
        goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = (0.4, -0.3, 0.25)
        self._goals.callback(goal, {})

    def stop(self) -> None:
        """Mode stop, and what it leads to."""
        client = self.system.ask("stop")
        self.system.run(AT_ONCE)
        assert client.report.current == "stop"

    def let_go(self) -> bool:
        return self.hand()[0] == "idle"


@pytest.fixture
def hand(instance: RunningInstance) -> Iterator[Hand]:
    settings = Settings(robot=Path("escher"), ros_domain_id=instance.settings.ros_domain_id)
    side = RosSide("somebody", settings, {}, (), node=partial(CommandNode, others=False))
    yield Hand(side)
    side.close()


@pytest.mark.parametrize("goals", [1, 2 * MAX_PER_CYCLE + 1])
def test_goals_that_a_stop_finds_in_the_same_cycle_do_not_go_on_after_it(hand: Hand, goals: int) -> None:
    for _ in range(goals):
        hand.goal()
    hand.stop()
    assert hand.let_go()
    hand.system.run(60)
    assert hand.let_go()


def test_a_second_stop_lets_a_hand_go_that_was_led_since_the_first(hand: Hand) -> None:
    hand.stop()
    hand.goal()
    hand.system.run(60)
    assert hand.hand()[0] == "moving"
    hand.stop()
    assert hand.let_go()


def test_a_stop_counts_that_another_mode_follows_in_the_same_cycle(hand: Hand) -> None:
    hand.goal()
    hand.system.run(60)
    assert hand.hand()[0] == "moving"
    hand.system.ask("stop")
    after = hand.system.ask("stand_manipulate")
    hand.system.run(AT_ONCE)
    assert after.report.current == "stand_manipulate"
    assert hand.let_go()
