"""A bag as the operator's page plays it: a joint that moves, and control modes that change."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from harness.bag_file import add_metadata, type_store, write_bag
from valor.bags.event import EVENT, Event

BEGIN, LENGTH, RATE = 1_700_000_000_000_000_000, 4.0, 250.0  # wall clock [ns], [s], of joint states [1/s]
JOINT = "l_knee_pitch"
MODES = {0.0: "stand_prep", 1.0: "stand", 3.0: "walk"}  # since the beginning [s]


def rows(store: Any, namespace: str = "") -> Iterator[tuple[int, str, str, Any]]:
    """Of ESCHER's left knee, which bends by 1 rad/s, and three control modes."""
    kinds, stamp = store.types, store.types["builtin_interfaces/msg/Time"]
    for number in range(round(LENGTH * RATE) + 1):
        seconds = number / RATE
        at = BEGIN + round(seconds * 1e9)
        header = kinds["std_msgs/msg/Header"](stamp=stamp(sec=0, nanosec=0), frame_id="")
        values = [np.array([value]) for value in (seconds, 1.0, 0.0)]
        state = kinds["sensor_msgs/msg/JointState"](header, [JOINT], *values)
        yield at, f"{namespace}/joint_states", "sensor_msgs/msg/JointState", state
        if seconds in MODES:
            name = "vigir_humanoid_control_msgs/msg/ControlModeStatus"
            mode = kinds[name](header, MODES[seconds], MODES[seconds], 1)
            yield at, f"{namespace}/flor/controller/mode", name, mode
        if number == 10:
            yield at, f"{namespace}/other/joint_states", "sensor_msgs/msg/JointState", state


def written(folder: Path, namespace: str = "") -> Path:
    """With a mark at 2.5 s."""
    store = type_store("vigir_humanoid_control_msgs")
    mark = Event(BEGIN + 2_500_000_000, "mark", "the knee is seen")
    write_bag(folder / "bag.mcap", store, rows(store, namespace))
    add_metadata(folder / "bag.mcap", EVENT, mark.record())
    return folder / "bag.mcap"
