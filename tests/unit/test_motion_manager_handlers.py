"""What comes in from outside has one handler a topic, and every state of locomotion a driver."""

from __future__ import annotations

import pytest

from harness.places import ROBOTS
from valor.common.behaviors import Locomotion
from valor.common.topics import DEVICES, SERVICE_TOPICS, TOPICS
from valor.motion_manager.handlers.handler import Handler, make_all
from valor.motion_manager.manager import MotionManager
from valor.robot.description import RobotDescription
from valor.robot.model import controller_model

NAME = "motion_manager"


@pytest.fixture(scope="module")
def manager() -> MotionManager:
    robot = RobotDescription.load(ROBOTS / "escher")
    return MotionManager(robot, controller_model(robot))


def test_every_topic_for_the_motion_manager_has_one_handler(manager: MotionManager) -> None:
    heard = sorted(handler.topic.name for handler in make_all(manager.parts))
    commands = [topic.name for topic in TOPICS if topic.name.startswith(f"{NAME}/") and topic.owner != NAME]
    requests = [topic.name for topic in SERVICE_TOPICS if topic.owner == NAME]
    assert heard == sorted([*commands, *requests, DEVICES.name])


def test_what_counts_message_by_message_waits_in_a_queue(manager: MotionManager) -> None:
    for handler in make_all(manager.parts):
        if isinstance(handler, Handler) and not handler.after_motor:
            assert handler.topic.queue, handler.topic.name


@pytest.mark.parametrize("locomotion", Locomotion)
def test_every_state_of_locomotion_has_a_driver_of_its_own(manager: MotionManager, locomotion: Locomotion) -> None:
    drivers = manager.parts.drivers
    assert [state for state in Locomotion if drivers.of(state) is drivers.of(locomotion)] == [locomotion]
