"""Robots and policies of others, with what their files do not state.

Those of holosoma come with its packages; policies of mujoco_playground are in ``tests/data``, and the robots that they
were trained for in a large package, which ``make robots`` installs.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from harness.places import REPOSITORY
from valor.robot.motion_tables import WHOLE_BODY
from valor.robot_setup.new import new_robot

PLAYGROUND = "playground"
_PLAYGROUND = REPOSITORY / "tests" / "data" / "mujoco_playground"


def package(name: str) -> Path:
    """Folder of an installed package, which is not imported."""
    found = importlib.util.find_spec(name)
    assert found is not None and found.submodule_search_locations, "run `make setup`"
    return Path(found.submodule_search_locations[0])


@dataclass(frozen=True)
class Stranger:
    """A robot, and what its policies need."""

    file: str  # its model, in the package
    standing: tuple[float, ...]  # default positions in the policy's order [rad]
    scales: tuple[float, float]  # of angular velocity, of joint velocities

    def model(self) -> Path:
        """Path of the model."""
        return package("holosoma") / "data" / "robots" / self.file


ROBOTS = {
    "g1": Stranger(
        "g1/g1_29dof.xml",
        (*[-0.312, 0, 0, 0.669, -0.363, 0] * 2, 0, 0, 0, 0.2, 0.2, 0, 0.6, 0, 0, 0, 0.2, -0.2, 0, 0.6, 0, 0, 0),
        (0.25, 0.05),
    ),
    "t1": Stranger(
        "t1/t1_29dof.xml",
        (0, 0, 0.2, -1.35, 0, -0.5, 0, 0, 0, 0.2, 1.35, 0, 0.5, 0, 0, 0, 0, *[-0.2, 0, 0, 0.4, -0.25, 0] * 2),
        (1.0, 0.1),
    ),
}


def facts(robot: str) -> dict[str, Any]:
    """The sidecar of its policies: holosoma sorts its terms by name."""
    turn, joints = ROBOTS[robot].scales
    return {
        "period": 0.02,
        "observation": [
            "last_action", {"term": "base_angular_velocity", "scale": turn}, "yaw_rate_command",
            "linear_velocity_command", "gait_cos", "joint_position_relative",
            {"term": "joint_velocity", "scale": joints}, "projected_gravity", "gait_sin",
        ],
        "gait": {"period": 1.0, "standing": float(np.pi)}, "action_scale": 0.25,
        "default_position": list(ROBOTS[robot].standing),
    }  # fmt: skip


def policy_of(robot: str, kind: str, folder: Path, **changes: Any) -> Path:
    """A walking policy of a kind (ppo, fastsac, playground), with its sidecar, in a folder."""
    file = folder / f"{kind}.onnx"
    if kind == PLAYGROUND:
        file.symlink_to(_PLAYGROUND / f"{robot}.onnx")
        own = yaml.safe_load((_PLAYGROUND / f"{robot}.yaml").read_text())
        file.with_suffix(".yaml").write_text(yaml.safe_dump(own | changes))
        return file
    file.symlink_to(next((package("holosoma_inference") / "models").rglob(f"{kind}_{robot}_29dof.onnx")))
    file.with_suffix(".yaml").write_text(yaml.safe_dump(facts(robot) | changes))
    return file


def folder_of(robot: str, model: Path, folder: Path, kinds: Sequence[str]) -> Path:
    """Make a folder of a robot's model, nothing edited but the controllers that it may have: policies by kind."""
    new_robot(model, folder, robot)
    (folder / "policies").mkdir()
    for kind in kinds:
        policy_of(robot, kind, folder / "policies")
    names = ", ".join((WHOLE_BODY, *kinds))
    with (folder / "robot.yaml").open("a") as opened:
        opened.write(f"\ncontrollers: {{ stand: [{names}], walk: [{names}] }}\n")
    return folder


def stranger(name: str, folder: Path) -> Path:
    """A policy of holosoma-inference without a sidecar."""
    (folder / "policy.onnx").symlink_to(next((package("holosoma_inference") / "models").rglob(f"{name}.onnx")))
    return folder / "policy.onnx"
