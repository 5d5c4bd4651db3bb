"""A robot of legs alone, in all its processes: it walks, and is refused what it has not the limbs for."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from harness.limbs import cut
from harness.places import ROBOTS
from harness.system import RosClient, running
from harness.waiting import wait_until
from valor.common.behaviors import NOTHING_TO_LEAD
from valor.robot.description import RobotDescription

GROUPS = ("left_arm", "right_arm", "neck", "torso")
pytestmark = pytest.mark.timeout(600)


def test_it_walks_and_is_refused_what_it_has_not(tmp_path: Path) -> None:
    robot = cut(RobotDescription.load(ROBOTS / "escher"), tmp_path / "legs", *GROUPS)
    with running("legs", tmp_path / "home", "--robot", str(robot.folder)) as system:
        client = RosClient(system.join())
        try:
            joints = wait_until(lambda: client.joint_state, 30.0, "/joint_states")
            assert list(joints.name) == list(robot.joints)
            walked = json.loads(system.valorctl("walk", "--vx", "0.25", "--distance", "0.5", "--json").stdout)
            assert not walked["fell"], walked
            assert walked["distance_m"] > 0.4
            assert walked["smallest_knee_angle_rad"] > 0.0
            for arguments, told in (
                (("mode", "stand_manipulate"), NOTHING_TO_LEAD),
                (("arm", "left", "home"), "no left arm"),
                (("hand", "right", "open"), "no right hand"),
            ):
                assert told in system.valorctl(*arguments, expect=1).stderr
            topics = {name for name, _ in client.node.get_topic_names_and_types()}
            assert "/flor/l_foot/force_torque_sensor" in topics
            assert not {"/flor/l_hand/force_torque_sensor", "/flor/r_hand/contact"} & topics
            states = {name.split("/")[-2] for name in topics if name.endswith("_traj_controller/controller_state")}
            assert states == {f"{group}_traj_controller" for group in ("left_leg", "right_leg", "pelvis")}
            assert system.status()["control_mode"] == "stand"
        finally:
            client.close()
