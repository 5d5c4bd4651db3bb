"""The whole chain on the hardware profile: a ROS goal at the top, the emulated arm at the bottom.

ROS client → VRC → Motion Manager → Comms Manager → HDT bridge → vendor's driver → emulated modules.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray

from harness.system import RosClient
from harness.waiting import PATIENCE, some, wait_until
from tests.integration.device_system import RobotOnDevices, on_devices
from tests.integration.vrc.vrc_system import (
    FORWARD,
    HOME,
    PATH_TOLERANCE_VIOLATED,
    STATUS_ABORTED,
    SUCCESSFUL,
    VRC,
    Topic,
    go,
    send,
)
from valor.common.topics import GROUND_TRUTH

NEAR = 0.02  # of a goal, at the emulated device [rad]
UPRIGHT = 0.7  # of the pelvis [m]


class Chain(RobotOnDevices):
    def __init__(self, running: Any) -> None:
        super().__init__(running)
        self._truth = GROUND_TRUTH.subscriber(self.node)
        self.ros = RosClient(running.environment)

    def off(self, goal: dict[str, float]) -> float:
        """Distance of the emulated joints from a goal, the largest [rad]."""
        truth = some(self._truth.receive(PATIENCE)).message
        assert truth.pelvis_position_in_world[2] > UPRIGHT
        indices = [self.robot.index[name] for name in goal]
        return float(np.abs(truth.joint_position[indices] - np.array(list(goal.values()))).max())


@pytest.fixture(scope="module")
def chain() -> Iterator[Chain]:
    """The chain, in Stand Manipulate."""
    with on_devices("hdt_driver", "hdt_bridge", actuators="hardware") as running:
        running.start(VRC)
        running.wait_ready(VRC, PATIENCE)
        made = Chain(running)
        go(made.ros, "stand")
        go(made.ros, "stand_manipulate")
        yield made
        made.ros.close()


def test_a_goal_on_ros_is_reached_by_the_emulated_arm(chain: Chain) -> None:
    assert chain.off(FORWARD) > 0.5
    answer = chain.ros.follow("right_arm", [(5.0, FORWARD)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
    wait_until(lambda: chain.off(FORWARD) < NEAR, PATIENCE, "the emulated arm at the goal")


@pytest.mark.parametrize("part", ["hdt_driver", "hdt/right_arm"])
def test_what_dies_under_a_goal_is_named_on_ros_and_the_robot_stands(chain: Chain, part: str) -> None:
    """A process, then the arm's modules; a goal after their return is reached again."""
    diagnostics = Topic(chain.ros, DiagnosticArray, "/diagnostics")
    target = HOME if chain.off(FORWARD) < 0.2 else FORWARD
    begun = chain.off(target)
    handle = send(chain.ros, target, 6.0)
    wait_until(lambda: chain.off(target) < begun - 0.1, PATIENCE, "the arm on its way")
    units: tuple[str, ...]
    if part == "hdt_driver":
        chain.running.kill(part)
        units, reason = ("hdt/right_arm", "hdt/left_arm"), "hdt_driver does not publish"
    else:
        chain.fail(part, "unplugged")
        units, reason = (part,), "none of its modules responds"
    answer = chain.ros._wait(chain.ros._call(handle.get_result_async), PATIENCE, "the end of the goal")
    assert answer.status == STATUS_ABORTED and answer.result.error_code == PATH_TOLERANCE_VIOLATED
    assert "r_shoulder_pitch" in answer.result.error_string
    wait_until(said(diagnostics, units, reason), PATIENCE, f"{units} on /diagnostics: {reason}")
    assert chain.behavior == "stand_manipulate" and chain.off(target) > 0.2
    if part == "hdt_driver":
        chain.running.start(part)
    else:
        chain.fail("hdt", "")
    wait_until(lambda: all(chain.unit(unit)[0] == "ok" for unit in units), PATIENCE, "the arm is back")
    go(chain.ros, "stand")  # it may have fallen far from its command, to which it returns slowly
    wait_until(lambda: chain.off(HOME) < 2 * NEAR, PATIENCE, "the emulated arm at home")
    go(chain.ros, "stand_manipulate")
    answer = chain.ros.follow("right_arm", [(5.0, target)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
    wait_until(lambda: chain.off(target) < NEAR, PATIENCE, "the emulated arm at the goal")
    diagnostics.close()


def said(diagnostics: Topic, units: tuple[str, ...], reason: str) -> Callable[[], bool]:
    """A check that every unit has been reported with the reason."""

    def there() -> bool:
        text = [f"{each.name} {each.message} {each.values}" for m in diagnostics.messages for each in m.status]
        return all(any(unit in line and reason in line for line in text) for unit in units)

    return there
