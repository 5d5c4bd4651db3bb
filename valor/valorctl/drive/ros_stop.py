"""`stop` as a ROS client: of the VRC, or, on the operator's side of a link, of ``link_operator``.

``python -m valor.valorctl.drive.ros_stop INSTANCE HOME MODE…`` requests these modes until the VRC accepts one, and
prints its answer as JSON. `stop` runs it as a separate process, so that it does not wait for the imports.
"""

import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Empty
from vigir_humanoid_control_msgs.action import ChangeControlMode

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import ModeStatus
from valor.common.stopping import LOCK, StopGoal, StopRoute
from valor.link.classes import BY_CLASS, MessageClass
from valor.valorctl.drive.control_mode import ACTION
from valor.valorctl.drive.ros_client import RosClient

_TIMEOUT = 10.0  # for the result of a mode [s]
_STATUS_TIMEOUT = 20.0  # for the first ``/link/status`` [s]
_REPEAT_PERIOD = 1.0  # of the soft stop, until the robot has stopped [s]
_LONGEST = (BY_CLASS[MessageClass.STOP].deadline or 0.0) + 5.0  # until a stop is executed and reported, or expired [s]


def request_modes(instance: Instance, modes: list[str]) -> str:
    """Request modes from the VRC until it accepts one; returns its last answer."""
    answer = ""
    try:
        with RosClient(instance) as ros:
            for mode in modes:
                goal = ChangeControlMode.Goal(mode_request=mode)
                result = ros.call_action(ChangeControlMode, ACTION, goal, _TIMEOUT).result
                if result.status & ModeStatus.MODE_ACCEPTED:
                    return f"control mode {result.current_control_mode}"
                answer = f"{mode} rejected; control mode {result.current_control_mode or 'none'}"
    except ValorError as error:
        return str(error)
    return answer


def stop_through_link(
    instance: Instance, goal: StopGoal, check: Callable[[], None]
) -> tuple[str, float, str, list[StopRoute]]:
    """Stop the robot through the link; returns the fields of ``stopping.Stop``.

    A behavior after the call confirms the stop. Raises ``ValorError``: ``link_operator`` publishes no status.
    """
    began = time.monotonic()
    path = StopRoute("link_robot, through the link")
    status: dict[str, str] = {}

    def store(message: DiagnosticStatus) -> None:
        status.clear()
        status.update({"": message.message} | {pair.key: pair.value for pair in message.values})

    with RosClient(instance, check) as ros:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        ros.subscribe(DiagnosticStatus, "link/status", store, latched)
        ros.wait(lambda: bool(status), _STATUS_TIMEOUT, "link_operator publishes no /link/status")
        publisher = None if goal is LOCK else ros.publisher(Empty, "flor/controller/soft_stop", 1)
        path.answer = "soft stop sent"
        if goal is LOCK:
            requested = ChangeControlMode.Goal(mode_request=goal.modes[0])
            result = ros.call_action(ChangeControlMode, ACTION, requested, _LONGEST + goal.longest).result
            path.answer = f"control mode {result.current_control_mode}"
        due = began

        def stopped() -> bool:
            nonlocal due
            if publisher is not None and time.monotonic() >= due:  # link_operator may discover the publisher late
                publisher.publish(Empty())
                due = time.monotonic() + _REPEAT_PERIOD
            recent = float(status.get("behavior_age", "inf")) < time.monotonic() - began
            return recent and status.get("behavior") in goal.reached

        try:
            ros.wait(stopped, _LONGEST, "")
        except ValorError:
            age = float(status.get("behavior_age", "inf"))
            seen = f"behavior {status.get('behavior') or 'unknown'}, at most {age:.1f} s old"
            return "", 0.0, f"{status.get('', '')}; {seen}", [path]
        path.after = time.monotonic() - began
        return status["behavior"], path.after, "", [path]


if __name__ == "__main__":
    os.setpriority(os.PRIO_PROCESS, 0, 0)  # its imports must not delay the path over Bifrost
    print(json.dumps(request_modes(Instance(sys.argv[1], Path(sys.argv[2])), sys.argv[3:])), flush=True)
