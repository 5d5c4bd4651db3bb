"""``python -m valor.valorctl.ros_stop INSTANCE HOME MODE…``: ask the VRC for the first of these modes that it grants.

A process of its own beside ``valorctl stop``, which does not wait for its imports. Prints what was answered as JSON.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from vigir_humanoid_control_msgs.action import ChangeControlMode

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import ModeStatus
from valor.valorctl.control_mode import ACTION
from valor.valorctl.ros_client import RosClient

_TIMEOUT = 10.0  # for the result [s]


def ask(instance: Instance, modes: list[str]) -> str:
    """What the VRC answered last."""
    if refusal := instance.settings().ros_refusal:
        return refusal
    answer = ""
    with RosClient(instance) as ros:
        for mode in modes:
            try:
                result = ros.call_action(
                    ChangeControlMode, ACTION, ChangeControlMode.Goal(mode_request=mode), _TIMEOUT
                ).result
            except ValorError as error:
                return str(error)
            if result.status & ModeStatus.MODE_ACCEPTED:
                return f"control mode {result.current_control_mode}"
            answer = f"{mode} refused; control mode {result.current_control_mode or 'none'}"
    return answer


if __name__ == "__main__":
    os.setpriority(os.PRIO_PROCESS, 0, 0)  # its imports are not in the way of the other path
    print(json.dumps(ask(Instance(sys.argv[1], Path(sys.argv[2])), sys.argv[3:])), flush=True)
