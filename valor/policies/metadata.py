"""Facts in an ONNX file's metadata: comma-separated (mjlab, BeyondMimic, legged_control2), or JSON (holosoma)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from valor.policies.facts import Reading, Source, TermFact

_CSV = {
    "joint_names": "joints", "default_joint_pos": "default_position", "joint_stiffness": "stiffness",
    "joint_damping": "damping", "action_scale": "action_scale",
}  # fmt: skip
_JSON = {
    "dof_names": "joints", "kp": "stiffness", "kd": "damping", "action_scale": "action_scale",
    "command_ranges": "command_ranges",
}  # fmt: skip
TERMS = {  # joint positions are relative to the default position
    "base_lin_vel": "base_linear_velocity", "base_ang_vel": "base_angular_velocity",
    "projected_gravity": "projected_gravity", "joint_pos": "joint_position_relative",
    "joint_pos_rel": "joint_position_relative", "joint_positions": "joint_position_relative",
    "joint_vel": "joint_velocity", "joint_vel_rel": "joint_velocity", "joint_velocities": "joint_velocity",
    "actions": "last_action", "last_action": "last_action",
}  # fmt: skip
# The command's term, which may also be of a motion, and the commands that are velocities.
_COMMAND = ("command", "commands", "velocity_commands", "generated_commands")
_VELOCITIES = ("twist", "base_velocity", "velocity")
_RANGES = {"lin_vel_x": "vx", "lin_vel_y": "vy", "ang_vel_yaw": "wz", "ang_vel_z": "wz"}


def read(metadata: Mapping[str, str]) -> Reading | None:
    """Read what the metadata state; None if they are of no convention."""
    if not metadata.keys().isdisjoint(("dof_names", "kp")):
        return _holosoma(metadata)
    named = metadata.keys().isdisjoint(("joint_names", "joint_stiffness", "observation_names"))
    return None if named else _csv(metadata)


def ranges(found: Any) -> dict[str, Any] | None:
    """Return ranges of velocity commands by our names; None without any."""
    known = found if isinstance(found, dict) else {}
    return {ours: known[name] for name, ours in _RANGES.items() if known.get(name) is not None} or None


def _csv(metadata: Mapping[str, str]) -> Reading:
    """Read comma-separated values. They state no period, no order of history and no order of quaternions."""
    reading = Reading("metadata, comma-separated (mjlab, BeyondMimic, legged_control2)")

    def listed(key: str, each: Callable[[str], Any]) -> Any:
        try:
            return [each(part.strip()) for part in metadata[key].split(",")] if key in metadata else None
        except ValueError:
            reading.reject(_CSV.get(key, "observation"), f"metadata {key}: {metadata[key]}", "values between commas")
            return None

    for key, fact in _CSV.items():
        values = listed(key, str if fact == "joints" else float)
        scalar = fact == "action_scale" and values is not None and len(values) == 1
        reading.state(fact, values[0] if scalar else values, Source.FILE, f"metadata {key}")
    reading.state("action_offset", "default_position", Source.DEFAULT, "actions are from the default position")
    reading.state("history_start", "repeat", Source.DEFAULT, "the first sample fills the history")
    names, commands = listed("observation_names", str) or [], listed("command_names", str) or []
    kinds: dict[str, Callable[[str], Any]] = {
        "scale": _numbers, "clip": _numbers, "history_length": int, "flatten_history_dim": str
    }  # fmt: skip
    lists = {key: listed(f"observation_terms_{key}", kind) for key, kind in kinds.items()}
    for key, values in lists.items():
        if values is not None and len(values) != len(names):
            found = f"{len(values)} values of observation_terms_{key}"
            reading.reject("observation", found, f"{len(names)}, one for each of observation_names")
            return reading
    terms = []
    for i, name in enumerate(names):
        scale, clip, history, flat = (None if values is None else values[i] for values in lists.values())
        if flat == "False" and (history or 0) > 1:
            reading.reject(f"observation {name}", "its history is a dimension of its own", "flat histories")
        velocity = name in _COMMAND and len(commands) == 1 and commands[0] in _VELOCITIES
        terms.append(
            TermFact(
                term="velocity_command" if velocity else TERMS.get(name, ""),
                name=f"{name} ({', '.join(commands)})" if name in _COMMAND else name,
                scale=1.0 if scale is None else scale[0] if len(scale) == 1 else scale,
                clip=None if clip in {None, (-float("inf"), float("inf"))} else (clip[0], clip[-1]),
                history=max(1, history or 0),
            )
        )
    where = "metadata observation_names" + ("; scale 1, no history: default" if lists["scale"] is None else "")
    reading.state("observation", tuple(terms) or None, Source.FILE, where)
    return reading


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(";"))


def _holosoma(metadata: Mapping[str, str]) -> Reading:
    """Read JSON values. They state no period, observation (in holosoma sorted by name) or default position."""
    reading = Reading("holosoma")
    for key, fact in _JSON.items():
        if key in metadata:
            try:
                value = json.loads(metadata[key])
            except ValueError:
                reading.reject(fact, f"metadata {key}: {metadata[key]}", "JSON")
                continue
            reading.state(fact, ranges(value) if fact == "command_ranges" else value, Source.FILE, f"metadata {key}")
    reading.state("action_offset", "default_position", Source.DEFAULT, "actions are from the default position")
    reading.state("action_clip", [(-100.0, 100.0)], Source.DEFAULT, "holosoma's own limit")
    reading.state("history_order", "oldest_first", Source.DEFAULT, "holosoma's own order")
    reading.state("history_start", "zeros", Source.DEFAULT, "holosoma's own start")
    return reading
