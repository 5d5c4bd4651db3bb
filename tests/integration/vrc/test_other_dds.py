"""Another DDS implementation reads the robot and changes its mode, in the domain and with the profile of ``up``."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from harness.instance import RunningInstance
from harness.system import RosClient
from tests.integration.vrc.vrc_system import go

CLIENT = Path(__file__).with_name("cyclone_client.py")


def test_cyclone_dds_reads_states_and_changes_the_mode(system: RunningInstance, ros: RosClient) -> None:
    pytest.importorskip("cyclonedds", reason="no CycloneDDS; `make .venv/stock.stamp` installs it, up to Python 3.13")
    go(ros, "stand")
    done = subprocess.run(
        [sys.executable, CLIENT], env=system.environment, capture_output=True, text=True, timeout=500, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["ros"] == []
    assert found["joints"] == 38 and found["vectors"] == [38]
    assert found["in order"] and found["clock"] > 0
    assert found["mode"] == ros.reports[-1].current_control_mode == "stand_manipulate"
    go(ros, "stand")
