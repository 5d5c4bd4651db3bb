"""What reaches the Motion Manager, and what it does: heard on its own host, whose cable may be out. For ``cables``.

    python -m benchmarks.cable_tap HOME INSTANCE FILE

Writes a JSON object a line, by the wall's clock [s], which all hosts of a benchmark share.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import bifrost
from valor.common.instance import Instance
from valor.common.topics import HAND_GOAL, MOTION_STATE, REJECTION, STEP_STATUS, VELOCITY

PERIOD = 0.05  # between two looks [s]


def main(home: str, name: str, file: str) -> None:
    """Hear until ended."""
    instance = Instance(name, Path(home))
    with (
        bifrost.Node("cable_tap", network=bifrost.Network.load(instance.network_file, instance.keys)) as node,
        open(file, "a", buffering=1, encoding="utf-8") as out,
    ):
        velocities, goals = VELOCITY.subscriber(node, queue=5000), HAND_GOAL.subscriber(node, queue=5000)
        steps = STEP_STATUS.subscriber(node, queue=1000)
        rejections, states = REJECTION.subscriber(node, queue=5000), MOTION_STATE.subscriber(node)

        def note(kind: str, **what: Any) -> None:
            out.write(json.dumps({"at": time.time(), "kind": kind, **what}) + "\n")

        while True:
            for velocity in velocities.drain():
                note("velocity", value=velocity.message.linear_x)
            for goal in goals.drain():
                note("hand", value=float(goal.message.position[2]) if goal.message.active else None)
            for step in steps.drain():
                if step.message.executing_step_index >= 0:
                    note("step", value=step.message.executing_step_index)
            for rejection in rejections.drain():
                note("rejection", value=rejection.message.topic, reason=rejection.message.reason)
            if (state := states.latest()) is not None:
                found = state.message
                place = [float(each) for each in found.pelvis_position_in_odom]
                setpoint = [round(float(each), 5) for each in found.joint_setpoint]
                _, x, y, _ = (float(each) for each in found.pelvis_orientation_in_odom)
                upright = 1.0 - 2.0 * (x * x + y * y)  # cosine of its lean
                note("state", behavior=found.behavior, place=place, upright=upright, setpoint=setpoint)
            time.sleep(PERIOD)


if __name__ == "__main__":
    main(*sys.argv[1:])
