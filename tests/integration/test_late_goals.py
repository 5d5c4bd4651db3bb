"""Goals of actions that were held back on their way, as by a cable, are refused, and their clients told why.

The server's process is stopped for a while: what comes for it waits, as it does where a network keeps it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient, CancelResponse

from harness.instance import RunningInstance
from harness.waiting import PATIENCE, wait_until
from valor.common.instance import Instance
from valor.ros.deferred_action_server import DeferredActionServer
from valor.ros.lateness import LATE
from valor.ros.node import ProcessNode, RosSide

NAME = "/arm/follow_joint_trajectory"


@contextmanager
def running(instance: Instance, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, __file__, *arguments],
        env=os.environ | instance.environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def said(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def obeyed(client: subprocess.Popen[str]) -> bool:
    """Whether a goal is, of which nothing is held back; a busy computer may."""
    sent(client)
    return said(client) == "succeeded obeyed"


def sent(client: subprocess.Popen[str]) -> None:
    assert client.stdin is not None
    client.stdin.write("send\n")
    client.stdin.flush()
    assert said(client) == "sent"


@pytest.mark.parametrize("others", [True, False])
def test_a_goal_that_comes_late_is_refused_where_other_computers_command(
    instance: RunningInstance, others: bool
) -> None:
    with running(instance.instance, "serve", str(others)) as server, running(instance.instance, "send") as client:
        assert said(server) == "serves" and said(client) == "sees it"
        wait_until(lambda: obeyed(client), PATIENCE, "a goal that comes at once is obeyed")
        server.send_signal(signal.SIGSTOP)
        sent(client)
        time.sleep(LATE + 0.5)  # the time on its way itself
        server.send_signal(signal.SIGCONT)
        told = said(client)
        if others:
            assert told.startswith("aborted came ") and "s after it was sent" in told
        else:
            assert told == "succeeded obeyed"
        wait_until(lambda: obeyed(client), PATIENCE, "it serves on")


def serve(settings: Any, others: bool) -> None:
    side = RosSide("server", settings, {}, (), node=lambda name, context: ProcessNode(name, context, others=others))
    result = FollowJointTrajectory.Result
    server: DeferredActionServer = DeferredActionServer(
        side.node,
        FollowJointTrajectory,
        NAME,
        lambda handle: server.finish(handle, "succeed", result(error_string="obeyed")),
        lambda handle: CancelResponse.REJECT,
        late=(lambda why: result(error_string=why)) if others else None,
    )
    print("serves", flush=True)
    while True:
        side.executor.spin_once()


def send(settings: Any) -> None:
    rclpy.init(domain_id=settings.ros_domain_id)
    node = rclpy.create_node("client")
    client = ActionClient(node, FollowJointTrajectory, NAME)
    client.wait_for_server()
    print("sees it", flush=True)
    for _ in sys.stdin:
        future = client.send_goal_async(FollowJointTrajectory.Goal())
        print("sent", flush=True)
        rclpy.spin_until_future_complete(node, future)
        ended = future.result().get_result_async()
        rclpy.spin_until_future_complete(node, ended)
        state = {4: "succeeded", 6: "aborted"}[ended.result().status]
        print(state, ended.result().result.error_string, flush=True)


if __name__ == "__main__":
    found = Instance(os.environ["VALOR_INSTANCE"], Path(os.environ["VALOR_HOME"])).settings()
    if sys.argv[1] == "serve":
        serve(found, sys.argv[2] == "True")
    else:
        send(found)
