"""Facts in YAML files that exporters write next to an ONNX file: Unitree's deploy.yaml, NVIDIA's LEAPP."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from valor.common.errors import ConfigurationError
from valor.policies.facts import Reading, Source, TermFact
from valor.policies.metadata import TERMS, ranges

_MAX_BYTES = 1 << 20
_KINDS = {"leapp": re.compile(rb"^models:", re.MULTILINE), "deploy": re.compile(rb"^joint_ids_map:", re.MULTILINE)}
_DEPLOY_TERMS = TERMS | {
    "velocity_commands": "velocity_command", "joint_pos": "joint_position", "gait_phase": "gait_clock"
}  # fmt: skip
_INPUT_KINDS = {
    "state/joint/position": "joint_position", "state/joint/velocity": "joint_velocity",
    "state/body/angular_velocity": "base_angular_velocity", "state/body/linear_velocity": "base_linear_velocity",
    "state/body/rotation": "base_orientation", "command/body/velocity": "velocity_command",
}  # fmt: skip
_OUTPUT_KINDS = {
    "target/joint/position": "position", "target/joint/velocity": "velocity", "target/joint/effort": "effort",
    "target/joint/torques": "effort", "kp": "stiffness", "kd": "damping",
}  # fmt: skip
# Elements in our order.
_WORDS: tuple[list[str], ...] = (["lin_vel_x", "lin_vel_y", "ang_vel_z"], ["vx", "vy", "wz"], ["x", "y", "z"], [])


class _Loader(yaml.SafeLoader):
    """Reads Python's own tags, which deploy.yaml has, as nothing."""


_Loader.add_multi_constructor("", lambda *_: None)


def find(file: Path) -> tuple[Path, str] | None:
    """Return the exporter's YAML file of an ONNX file, and its kind, ``deploy`` or ``leapp``; None without one."""
    own = [file.with_suffix(f"{kind}.yaml") for kind in (".deploy", ".leapp", "")]
    near = [file.with_name("deploy.yaml"), file.parent.parent / "params" / "deploy.yaml"]
    for candidate in [*own, *near, *sorted(file.parent.glob("*.yaml"))]:
        if candidate.is_file() and candidate.stat().st_size <= _MAX_BYTES:
            data = candidate.read_bytes()
            for kind, pattern in _KINDS.items():
                named = candidate in own or (kind == "deploy" and candidate in near) or file.name.encode() in data
                if named and pattern.search(data):
                    return candidate, kind
    return None


def read(file: Path, kind: str) -> Reading:
    """Read what ``find`` found. Raises ConfigurationError; others if values are not as the exporter writes them."""
    try:
        content = yaml.load(file.read_bytes(), _Loader)
    except (yaml.YAMLError, RecursionError) as error:
        raise ConfigurationError(f"{file}: not YAML: {' '.join(str(error).split())[:200]}") from None
    return _leapp(content, file.parent) if kind == "leapp" else _deploy(content)


def _at(content: Any, *keys: str) -> Any:
    """Return a value inside mappings; None without one."""
    for key in keys:
        content = (content or {}).get(key)
    return content


def _deploy(content: Mapping[str, Any]) -> Reading:
    """Read deploy.yaml: gains are in the order of motors, all else in the policy's; it states no joint names.

    ``joints`` of the sidecar are then in the order of motors, that of Unitree's SDK.
    """
    reading = Reading("Unitree deploy.yaml")
    order = [int(i) for i in content["joint_ids_map"]]
    if sorted(set(order)) != sorted(order) or min(order) < 0:
        reading.reject("joint_ids_map", order, "different indices of motors")
    reading.state("motor_order", order, Source.TABLE, "joint_ids_map")
    for fact in ("stiffness", "damping"):
        values = content.get(fact) or []
        if len(values) > max(order):
            reading.state(fact, [values[i] for i in order], Source.TABLE, f"{fact}, in the order of motors")
    if list(content.get("actions") or ()) != ["JointPositionAction"]:
        found = ", ".join(map(str, content.get("actions") or ())) or "no action"
        reading.reject("outputs", found, "JointPositionAction alone")
    ours = {
        "default_position": ("default_joint_pos",),
        "period": ("step_dt",),
        "action_scale": ("actions", "JointPositionAction", "scale"),
        "action_offset": ("actions", "JointPositionAction", "offset"),
        "position_clip": ("actions", "JointPositionAction", "clip"),
    }
    for fact, keys in ours.items():
        reading.state(fact, _at(content, *keys), Source.TABLE, ".".join(keys))
    velocity = ranges(_at(content, "commands", "base_velocity", "ranges"))
    reading.state("command_ranges", velocity, Source.TABLE, "commands.base_velocity.ranges")
    observations = content.get("observations") or {}
    terms = [_deploy_term(str(name), each or {}) for name, each in observations.items()]
    reading.state("observation", tuple(terms) or None, Source.TABLE, "observations")
    if (period := _at(observations, "gait_phase", "params", "period")) is not None:
        gait = {"period": float(period), "offsets": [0.0]}
        reading.state("gait", gait, Source.TABLE, "observations.gait_phase.params.period")
    reading.state("history_order", "oldest_first", Source.DEFAULT, "Unitree's own order")
    reading.state("history_start", "repeat", Source.DEFAULT, "Unitree's own start")
    return reading


def _deploy_term(name: str, stated: Mapping[str, Any]) -> TermFact:
    scale, clip = stated.get("scale"), stated.get("clip")
    values = tuple(map(float, scale)) if isinstance(scale, list) else (float(1.0 if scale is None else scale),)
    by_index = _at(stated, "params", "asset_cfg", "joint_ids") is not None
    return TermFact(
        term="" if by_index else _DEPLOY_TERMS.get(name, ""),
        name=name,
        scale=values[0] if len(set(values)) == 1 else values,
        clip=None if clip is None else (float(clip[0]), float(clip[1])),
        history=max(1, int(stated.get("history_length") or 1)),
        size=len(scale) if isinstance(scale, list) else None,
    )


def _leapp(content: Mapping[str, Any], folder: Path) -> Reading:
    """Read LEAPP's YAML: inputs are raw state, each with its kind; outputs are targets and gains."""
    reading = Reading("LEAPP")
    if len(content["models"]) != 1:
        reading.reject("outputs models", ", ".join(content["models"]), "one model, exported as one graph")
    name, model = next(iter(content["models"].items()))
    pipeline = content.get("pipeline") or {}
    states = {each["name"]: each["name"] for each in model["inputs"] if each.get("is_state")}
    feedback = states | dict(_connections(pipeline, f"{name}/"))
    reading.state("feedback", feedback or None, Source.TABLE, "pipeline, is_state")
    if frequency := _at(pipeline, "configs", "frequency"):
        reading.state("period", 1.0 / frequency, Source.TABLE, "pipeline.configs.frequency")
    inputs = [each for each in model["inputs"] if each["name"] not in feedback]
    reading.state("observation", tuple(map(_leapp_term, inputs)), Source.TABLE, "inputs' kinds")
    for each in inputs:
        if each.get("kind") == "state/body/rotation":
            order = "".join(word[-1] for word in _elements(each))  # qx, qy, qz, qw
            reading.state("quaternion_order", order or None, Source.TABLE, f"element_names of {each['name']}")
    roles: dict[str, Any] = {}
    for each in model["outputs"]:
        if each["name"] in feedback.values() and not each.get("kind"):
            continue
        role, names = _OUTPUT_KINDS.get(str(each.get("kind"))), _elements(each)
        if role is None or role in roles or not names or each.get("temporal_period_ms"):
            found = f"kind {each.get('kind')}, element_names {names}"
            reading.reject(f"outputs.{each['name']}", found, "one target, kp or kd of named joints, no time axis")
        else:
            roles[role] = {"output": each["name"], "joints": names}
    reading.state("outputs", roles or None, Source.TABLE, "outputs' kinds")
    reading.state("joints", _at(roles, "position", "joints"), Source.TABLE, "element_names of targets")
    if initial := pipeline.get("initial_values"):
        stored = _safetensors(folder / Path(str(initial)).name)
        reading.initial = {key.rpartition("/")[2]: values for key, values in stored.items()}
    return reading


def _leapp_term(stated: Mapping[str, Any]) -> TermFact:
    name, kind, words = str(stated["name"]), str(stated.get("kind")), _elements(stated)
    about = f"{name} {stated.get('isaaclab_connection', '')}"
    term = _INPUT_KINDS.get(kind, "")
    if kind == "state/vector3d" and "projected_gravity" in about:
        term = "projected_gravity"
    if term in {"base_angular_velocity", "base_linear_velocity"} and re.search(r"_w\b", about):
        term = ""  # in the world's frame
    joints = tuple(words) if term.startswith("joint_") and words else None
    if joints is None and term != "base_orientation" and words not in _WORDS:
        term = ""  # in another order
    shape = stated.get("shape") or ()
    size = math.prod(json.loads(shape) if isinstance(shape, str) else shape) if shape else None
    return TermFact(term=term, name=f"{name} ({kind})", size=size, joints=joints, input=name)


def _elements(stated: Mapping[str, Any]) -> list[str]:
    """Return the names of the last axis."""
    names = stated.get("element_names") or []
    return [str(name) for name in (names[-1] if names and isinstance(names[-1], list) else names)]


def _connections(pipeline: Mapping[str, Any], model: str) -> Iterator[tuple[str, str]]:
    """Yield input and output of each connection back, which some files name ``feedback_connections``."""
    found = pipeline.get("feedback_flow") or pipeline.get("feedback_connections") or {}
    pairs = found.items() if isinstance(found, dict) else ((each["source"], each["target"]) for each in found)
    for source, targets in pairs:
        for target in targets if isinstance(targets, list) else [targets]:
            yield target.removeprefix(model), source.removeprefix(model)


def _safetensors(file: Path) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a safetensors file: a header's length, the header as JSON, the numbers."""
    try:
        data = file.read_bytes()
        end = 8 + int.from_bytes(data[:8], "little")
        return {
            name: np.frombuffer(data[end:][slice(*each["data_offsets"])], {"F32": "<f4", "F64": "<f8"}[each["dtype"]])
            for name, each in json.loads(data[8:end]).items()
            if name != "__metadata__"
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{file}: not read ({error!r}); expected the initial values of LEAPP's YAML") from None
