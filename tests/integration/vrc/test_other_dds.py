"""Another DDS implementation reads the robot and drives it, over the domain and profile that ``up`` gives."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from harness.instance import RunningInstance
from harness.system import RosClient
from tests.integration.vrc.vrc_system import FORWARD, HOME, STATUS_SUCCEEDED, SUCCESSFUL, errors, found_by, go

CLIENT = Path(__file__).with_name("cyclone_client.py")
ACTION = "/right_arm_traj_controller/follow_joint_trajectory"


def test_cyclone_dds_reads_states_changes_the_mode_and_moves_an_arm(system: RunningInstance, ros: RosClient) -> None:
    pytest.importorskip("cyclonedds", reason="no CycloneDDS; `make .venv/stock.stamp` installs it, up to Python 3.13")
    go(ros, "stand")
    here = errors(ros, HOME)
    target = FORWARD if max(here.values()) < 0.5 else HOME
    found = found_by(system, CLIENT, ACTION, json.dumps(target))
    assert found["ros"] == []
    assert found["joints"] == 38 and found["vectors"] == [38]
    assert found["states"] > 250 and found["in order"] and found["clock"] > 0
    assert found["mode"] == "stand_manipulate"
    assert (found["status"], found["error"][0]) == (STATUS_SUCCEEDED, SUCCESSFUL), found["error"]
    assert max(errors(ros, target).values()) < 0.05
    go(ros, "stand")
