"""A robot of four joints, and an affine policy for it in each of the four conventions."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from msgspec import structs

from harness.onnx_file import BIAS, affine
from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.policies.observations import Senses
from valor.robot.description import RobotDescription

JOINTS = ("l_hip_pitch", "l_knee_pitch", "r_hip_pitch", "r_knee_pitch")
ZERO = np.array([-0.3, 0.6, -0.2, 0.5])
SCALE = np.array([0.25, 0.5, 0.75, 1.0])
STIFFNESS = np.array([100.0, 200.0, 300.0, 400.0])
DAMPING = np.array([1.0, 2.0, 3.0, 4.0])
ESCHER = RobotDescription.load(ROBOTS / "escher")


def robot_with(names: Iterable[str]) -> RobotDescription:
    """ESCHER's tables with other joints, which turn half a turn either way."""
    joint = structs.replace(ESCHER.tables.joints["l_knee_pitch"], lower=-3.2, upper=3.2)
    tables = structs.replace(ESCHER.tables, joints=dict.fromkeys(names, joint), nominal_posture={})
    return RobotDescription(ESCHER.folder, tables, checked=False)


def senses(random: np.random.Generator, robot: RobotDescription = ESCHER) -> Senses:
    n = len(robot.joints)
    attitude = random.normal(size=4)
    return Senses(
        random.normal(size=n), random.normal(size=n), attitude / np.linalg.norm(attitude), random.normal(size=3),
        random.normal(size=3), random.uniform(-0.3, 0.3, 3),
    )  # fmt: skip


def weights(size: int, outputs: int = len(JOINTS), seed: int = 1) -> dict[str, FloatArray]:
    random = np.random.default_rng(seed)
    return {"obs": random.normal(0, 0.1, (size, outputs)), BIAS: random.normal(0, 0.1, outputs)}


def csv(values: Iterable[object]) -> str:
    return ",".join(f"{each:.3f}" if isinstance(each, float) else str(each) for each in values)


def mjlab(folder: Path, **changes: str | None) -> Path:
    """base_ang_vel, projected_gravity, command, joint_pos of three samples, joint_vel, actions: 3 + 3 + 3 + 12 + 8."""
    metadata = {
        "joint_names": csv(JOINTS), "joint_stiffness": csv(STIFFNESS), "joint_damping": csv(DAMPING),
        "default_joint_pos": csv(ZERO), "action_scale": csv(SCALE), "command_names": "twist",
        "observation_names": "base_ang_vel,projected_gravity,command,joint_pos,joint_vel,actions",
        "observation_terms_scale": "0.250,1.000,1.000,1.000,0.500;0.500;0.500;0.250,1.000",
        "observation_terms_history_length": "0,0,0,3,0,0",
        "observation_terms_flatten_history_dim": "True,True,True,True,True,True",
        "observation_terms_clip": "-1.000;1.000,-inf;inf,-inf;inf,-inf;inf,-inf;inf,-inf;inf",
    } | changes  # fmt: skip
    kept = {key: text for key, text in metadata.items() if text is not None}
    return affine(folder / "walk.onnx", {"obs": 29}, {"actions": weights(29)}, kept)


def holosoma(folder: Path, **changes: Any) -> Path:
    metadata = {
        "dof_names": list(JOINTS), "kp": STIFFNESS.tolist(), "kd": DAMPING.tolist(),
        "command_ranges": {"lin_vel_x": [-0.1, 0.2], "lin_vel_y": [-1, 1], "ang_vel_yaw": [-1, 1], "heading": [-3, 3]},
    } | changes  # fmt: skip
    stored = {key: json.dumps(value) for key, value in metadata.items() if value is not None}
    return affine(folder / "walk.onnx", {"actor_obs": 15}, {"action": {"actor_obs": weights(15)["obs"]}}, stored)


def unitree(folder: Path, **changes: Any) -> Path:
    """Motors are in another order than the policy's joints: joint 0 is motor 2, and so on."""
    order = [2, 0, 3, 1]
    gains = {"stiffness": np.zeros(4), "damping": np.zeros(4)}
    gains["stiffness"][order], gains["damping"][order] = STIFFNESS, DAMPING
    term: dict[str, Any] = {"params": {}, "clip": None, "history_length": 2}
    table: dict[str, Any] = {
        "joint_ids_map": order, "step_dt": 0.02, "default_joint_pos": ZERO.tolist(),
        **{name: values.tolist() for name, values in gains.items()},
        "commands": {"base_velocity": {"ranges": {"lin_vel_x": [-0.1, 0.2], "ang_vel_z": [-1, 1], "heading": None}}},
        "actions": {"JointPositionAction": {"clip": [[-0.4, 0.4]] * 4, "scale": SCALE.tolist(),
                                            "offset": ZERO.tolist(), "joint_names": [".*"]}},
        "observations": {
            "base_ang_vel": term | {"scale": [0.2] * 3},
            "velocity_commands": term | {"scale": [1.0] * 3, "history_length": 1},
            "joint_pos_rel": term | {"scale": [1.0] * 4, "clip": [-0.5, 0.5]},
            "last_action": term | {"scale": [1.0] * 4},
        },
    } | changes  # fmt: skip
    slices = "\nunused: !!python/object/apply:builtins.slice [null, null, null]\n"  # as the exporter has
    (folder / "deploy.yaml").write_text(yaml.safe_dump(table, sort_keys=False) + slices)
    return affine(folder / "walk.onnx", {"obs": 25}, {"actions": weights(25)})


def leapp(folder: Path, **changes: Any) -> Path:
    """Raw state in, targets and gains out, joints in an order of their own each; the last action is fed back."""
    state, target = list(JOINTS), [JOINTS[i] for i in (3, 1, 0, 2)]
    inputs: dict[str, dict[str, Any]] = {
        "q": {"shape": [1, 4], "kind": "state/joint/position", "element_names": [state[::-1]]},
        "gyro": {"shape": "[1, 3]", "kind": "state/body/angular_velocity", "element_names": [["x", "y", "z"]]},
        "quat": {"shape": [1, 4], "kind": "state/body/rotation", "element_names": [["qx", "qy", "qz", "qw"]]},
        "cmd": {"shape": [1, 3], "kind": "command/body/velocity",
                "element_names": [["lin_vel_x", "lin_vel_y", "ang_vel_z"]]},
        "last_action": {"shape": [1, 4]},
    }  # fmt: skip
    outputs: dict[str, dict[str, Any]] = {
        "targets": {"shape": [1, 4], "kind": "target/joint/position", "element_names": [target]},
        "kp": {"shape": [1, 4], "kind": "kp", "element_names": [state]},
        "kd": {"shape": [1, 4], "kind": "kd", "element_names": [state]},
        "action": {"shape": [1, 4]},
    }
    parts: dict[str, Any] = {
        "inputs": inputs, "outputs": outputs,
        "pipeline": {"feedback_flow": {"net/action": ["net/last_action"]}, "configs": {"frequency": 50}},
    }  # fmt: skip
    for key, change in changes.items():
        parts[key] = parts[key] | change
    listed = {key: [{"name": name, "dtype": "float32", **each} for name, each in parts[key].items() if each is not None]
              for key in ("inputs", "outputs")}  # fmt: skip
    model = {"net": listed | {"parameters": {"backend": "onnx", "model_path": "./walk.onnx"}}}
    table = {"models": model, "pipeline": parts["pipeline"], "system information": {"leapp version": "0.7.2"}}
    (folder / "graph.yaml").write_text(yaml.safe_dump(table, sort_keys=False))
    sizes = {name: 3 if name in {"gyro", "cmd"} else 4 for name in inputs}
    random = np.random.default_rng(3)
    net = {name: random.normal(0, 0.1, (size, 4)) for name, size in sizes.items()}
    return affine(
        folder / "walk.onnx", sizes,
        {"targets": net, "kp": {BIAS: STIFFNESS}, "kd": {BIAS: DAMPING}, "action": net},
    )  # fmt: skip


def write(file: Path, facts: Mapping[str, Any]) -> Path:
    """A sidecar."""
    file.with_suffix(".yaml").write_text(yaml.safe_dump(dict(facts), sort_keys=False))
    return file
