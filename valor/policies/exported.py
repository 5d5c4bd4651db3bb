"""Facts in YAML files that exporters write next to an ONNX file: Unitree's deploy.yaml, NVIDIA's LEAPP."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from valor.common.errors import ConfigurationError
from valor.policies.facts import Reading, Source, TermFact
from valor.policies.metadata import ranges

_MAX_BYTES = 1 << 20
_DEPLOY_TERMS = {
    "base_ang_vel": "base_angular_velocity",
    "base_lin_vel": "base_linear_velocity",
    "projected_gravity": "projected_gravity",
    "velocity_commands": "velocity_command",
    "joint_pos_rel": "joint_position_relative",
    "joint_pos": "joint_position",
    "joint_vel_rel": "joint_velocity",
    "joint_vel": "joint_velocity",
    "last_action": "last_action",
    "gait_phase": "gait_clock",
}
_INPUT_KINDS = {
    "state/joint/position": "joint_position",
    "state/joint/velocity": "joint_velocity",
    "state/body/angular_velocity": "base_angular_velocity",
    "state/body/linear_velocity": "base_linear_velocity",
    "state/body/rotation": "base_orientation",
    "command/body/velocity": "velocity_command",
}
_OUTPUT_KINDS = {
    "target/joint/position": "position",
    "target/joint/velocity": "velocity",
    "target/joint/effort": "effort",
    "target/joint/torques": "effort",
    "kp": "stiffness",
    "kd": "damping",
}
_WORDS = (["lin_vel_x", "lin_vel_y", "ang_vel_z"], ["vx", "vy", "wz"], ["x", "y", "z"])  # elements in our order


class _Loader(yaml.SafeLoader):
    """Reads Python's own tags, which deploy.yaml has, as nothing."""


_Loader.add_multi_constructor("", lambda *_: None)


def _load(file: Path) -> Any:
    """Return the content of an exporter's YAML file. Raises ConfigurationError."""
    try:
        if file.stat().st_size > _MAX_BYTES:
            raise ConfigurationError(f"{file}: expected at most {_MAX_BYTES} bytes")
        return yaml.load(file.read_bytes(), _Loader)
    except OSError as error:
        raise ConfigurationError(f"{file}: {error.strerror}") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ConfigurationError(f"{file}: not YAML: {' '.join(str(error).split())[:200]}") from None


def find(file: Path) -> tuple[Path, str] | None:
    """Return the exporter's YAML file of an ONNX file, and its kind, ``deploy`` or ``leapp``; None without one."""
    stem = file.with_suffix("").name
    named = [file.with_name(f"{stem}.{kind}.yaml") for kind in ("deploy", "leapp")]
    near = [file.with_name("deploy.yaml"), file.parent.parent / "params" / "deploy.yaml"]
    others = sorted(file.parent.glob("*.yaml"))
    for candidate in [*named, file.with_suffix(".yaml"), *near]:
        if candidate.is_file() and (kind := _kind(_load(candidate))):
            return candidate, kind
    for candidate in others:  # LEAPP's has the name of the graph
        with contextlib.suppress(ConfigurationError):
            content = _load(candidate)
            if _kind(content) == "leapp" and any(Path(path).name == file.name for path in _paths(content)):
                return candidate, "leapp"
    return None


def _kind(content: Any) -> str:
    if not isinstance(content, dict):
        return ""
    return "leapp" if "models" in content else "deploy" if "joint_ids_map" in content else ""


def _paths(content: Any) -> Iterator[str]:
    for each in (content["models"] or {}).values():
        yield str((each.get("parameters") or {}).get("model_path", ""))


def read(file: Path, kind: str) -> Reading:
    """Read what ``find`` found. Raises ConfigurationError; others if values are not as the exporter writes them."""
    content = _load(file)
    return _leapp(content, file.parent) if kind == "leapp" else _deploy(content)


def _deploy(content: Mapping[str, Any]) -> Reading:
    """Read deploy.yaml: gains are in the order of motors, all else in the policy's; it states no joint names.

    ``joints`` of the sidecar are then in the order of motors, that of Unitree's SDK.
    """
    reading = Reading("Unitree deploy.yaml")
    order = content.get("joint_ids_map")
    if not isinstance(order, list) or sorted(order) != sorted({int(i) for i in order}) or min(order, default=-1) < 0:
        reading.reject("joint_ids_map", order, "different indices of motors")
        return reading
    order = [int(i) for i in order]
    reading.state("motor_order", order, Source.TABLE, "joint_ids_map")
    for key, fact in (("stiffness", "stiffness"), ("damping", "damping")):
        values = content.get(key)
        if not isinstance(values, list) or len(values) <= max(order):
            reading.reject(fact, values, f"{key} with motor {max(order)}")
        else:
            reading.state(fact, [values[i] for i in order], Source.TABLE, f"{key}, in the order of motors")
    reading.state("default_position", content.get("default_joint_pos"), Source.TABLE, "default_joint_pos")
    reading.state("period", content.get("step_dt"), Source.TABLE, "step_dt")
    velocity = ((content.get("commands") or {}).get("base_velocity") or {}).get("ranges")
    reading.state("command_ranges", ranges(velocity), Source.TABLE, "commands.base_velocity.ranges")
    actions = content.get("actions") or {}
    if list(actions) != ["JointPositionAction"]:
        reading.reject("outputs", ", ".join(map(str, actions)) or "no action", "JointPositionAction alone")
    action = actions.get("JointPositionAction") or {}
    for key, fact in (("scale", "action_scale"), ("offset", "action_offset"), ("clip", "position_clip")):
        reading.state(fact, action.get(key), Source.TABLE, f"actions.JointPositionAction.{key}")
    observations = content.get("observations") or {}
    terms = [_deploy_term(str(name), each or {}) for name, each in observations.items()]
    reading.state("observation", tuple(terms) or None, Source.TABLE, "observations")
    period = ((observations.get("gait_phase") or {}).get("params") or {}).get("period")
    gait = None if period is None else {"period": period, "offsets": [0.0]}
    reading.state("gait", gait, Source.TABLE, "observations.gait_phase.params.period")
    reading.state("history_order", "oldest_first", Source.DEFAULT, "Unitree's own order")
    reading.state("history_start", "repeat", Source.DEFAULT, "Unitree's own start")
    return reading


def _deploy_term(name: str, stated: Mapping[str, Any]) -> TermFact:
    scale, clip = stated.get("scale"), stated.get("clip")
    values = tuple(map(float, scale)) if isinstance(scale, list) else (float(1.0 if scale is None else scale),)
    subset = ((stated.get("params") or {}).get("asset_cfg") or {}).get("joint_ids")
    return TermFact(
        term=_DEPLOY_TERMS.get(name, "") if subset is None else "",  # a subset is by index
        name=name,
        scale=values[0] if len(set(values)) == 1 else values,
        clip=None if clip is None else (float(clip[0]), float(clip[1])),
        history=max(1, int(stated.get("history_length") or 1)),
        size=len(scale) if isinstance(scale, list) else None,
    )


def _leapp(content: Mapping[str, Any], folder: Path) -> Reading:
    """Read LEAPP's YAML: inputs are raw state, each with its kind; outputs are targets and gains."""
    reading = Reading("LEAPP")
    models = content.get("models") or {}
    if len(models) != 1:
        reading.reject("outputs models", ", ".join(map(str, models)) or "none", "one model, exported as one graph")
        return reading
    ((name, model),) = models.items()
    pipeline = content.get("pipeline") or {}
    inputs, outputs = model.get("inputs") or [], model.get("outputs") or []
    feedback = dict(_connections(pipeline, str(name)))
    for each in inputs:
        if each.get("is_state") and each["name"] not in feedback:
            feedback[each["name"]] = each["name"]  # checked against the outputs later
    reading.state("feedback", feedback or None, Source.TABLE, "pipeline, is_state")
    frequency = (pipeline.get("configs") or {}).get("frequency")
    reading.state("period", 1.0 / frequency if frequency else None, Source.TABLE, "pipeline.configs.frequency")
    terms, elements = [], {}
    for each in inputs:
        if each["name"] not in feedback:
            terms.append(_leapp_term(each))
            elements[each["name"]] = _elements(each)
    reading.state("observation", tuple(terms), Source.TABLE, "inputs' kinds")
    for term in terms:
        if term.term == "base_orientation" and (words := elements[str(term.input)]):
            order = "".join(word[-1] for word in words)  # qx, qy, qz, qw
            reading.state("quaternion_order", order, Source.TABLE, f"element_names of {term.input}")
    roles: dict[str, Any] = {}
    for each in outputs:
        if each["name"] in feedback.values() and not each.get("kind"):
            continue
        role = _OUTPUT_KINDS.get(str(each.get("kind")))
        names = _elements(each)
        if role is None or each.get("temporal_period_ms"):
            reading.reject(f"outputs.{each['name']}", f"kind {each.get('kind')}", "a target or gains of joints, now")
        elif not names:
            reading.reject(f"outputs.{each['name']}", "no element_names", "names of joints")
        elif role in roles:
            reading.reject(f"outputs.{each['name']}", f"a second {role}", "one")
        else:
            roles[role] = {"output": each["name"], "joints": names}
    reading.state("outputs", roles or None, Source.TABLE, "outputs' kinds")
    reading.state("joints", (roles.get("position") or {}).get("joints"), Source.TABLE, "element_names of targets")
    if initial := pipeline.get("initial_values"):
        stored = _safetensors(folder / Path(str(initial)).name)
        reading.initial = {key.rpartition("/")[2]: values for key, values in stored.items()}
    return reading


def _leapp_term(stated: Mapping[str, Any]) -> TermFact:
    name, words = str(stated["name"]), _elements(stated)
    kind, about = str(stated.get("kind")), f"{name} {stated.get('isaaclab_connection', '')}"
    term = _INPUT_KINDS.get(kind, "")
    if kind == "state/vector3d" and "projected_gravity" in about:
        term = "projected_gravity"
    joints = tuple(words) if term.startswith("joint_") and words else None
    if "velocity" in kind and kind.startswith("state/body") and any(word.endswith("_w") for word in about.split()):
        term = ""  # in the world's frame
    if term in {"base_angular_velocity", "base_linear_velocity", "velocity_command"} and words and words not in _WORDS:
        term = ""  # in another order
    shape = stated.get("shape")
    sizes = json.loads(shape) if isinstance(shape, str) else shape or []
    return TermFact(
        term=term, name=f"{name} ({kind})", size=math.prod(sizes) if sizes else None, joints=joints, input=name
    )


def _elements(stated: Mapping[str, Any]) -> list[str]:
    """Return the names of the last axis."""
    names = stated.get("element_names") or []
    last = names[-1] if names and isinstance(names[-1], list) else names
    return [str(name) for name in last]


def _connections(pipeline: Mapping[str, Any], model: str) -> Iterator[tuple[str, str]]:
    """Yield input and output of each connection back; older files have ``feedback_connections``."""
    found = pipeline.get("feedback_flow") or pipeline.get("feedback_connections") or {}
    pairs = found.items() if isinstance(found, dict) else ((each["source"], each["target"]) for each in found)
    for source, targets in pairs:
        for target in targets if isinstance(targets, list) else [targets]:
            yield str(target).removeprefix(f"{model}/"), str(source).removeprefix(f"{model}/")


def _safetensors(file: Path) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a safetensors file: a header's length, the header as JSON, the numbers."""
    try:
        data = file.read_bytes()
        end = 8 + int.from_bytes(data[:8], "little")
        header = json.loads(data[8:end])
        return {
            name: np.frombuffer(data[end:][slice(*each["data_offsets"])], {"F32": "<f4", "F64": "<f8"}[each["dtype"]])
            for name, each in header.items()
            if name != "__metadata__"
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{file}: not read ({error!r}); expected the initial values of LEAPP's YAML") from None
