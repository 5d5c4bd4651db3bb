"""One converter, and one client of it, for all files of this folder."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import bifrost
from harness.instance import RunningInstance, fresh_instance
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.footstep_converter.scripted_motion_manager import ScriptedMotionManager
from tests.integration.plan_client import LIMIT, PlanClient


@pytest.fixture(scope="package")
def instance() -> Iterator[RunningInstance]:
    home = Path(tempfile.mkdtemp(prefix="valor-"))
    with fresh_instance(home) as running, pytest.MonkeyPatch.context() as environment:
        for name, value in running.instance.environment().items():
            environment.setenv(name, value)
        running.start("footstep_converter", wait=True)
        yield running
    shutil.rmtree(home, ignore_errors=True)


@pytest.fixture(scope="package")
def ros_client(instance: RunningInstance) -> Iterator[PlanClient]:
    ros = RosClient(instance.environment, joint_states=False)
    yield PlanClient(ros)
    ros.close()


@pytest.fixture
def motion(instance: RunningInstance, ros_client: PlanClient) -> Iterator[ScriptedMotionManager]:
    """One for each test; a fall ends whatever plan a test leaves behind."""
    scripted = ScriptedMotionManager(bifrost.Node("motion_manager", network=instance.network))
    scripted.wait_until_received()
    yield scripted
    scripted.silent, scripted.behavior = False, "fall"
    try:
        wait_until(lambda: all(goal.result for goal in ros_client.goals), LIMIT, "the end of all goals")
    finally:
        ros_client.goals.clear()
        scripted.close()
