"""ROS 2 between computers: network namespaces with their own interfaces, joined by cables."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path

import pytest

from harness.system import VALORCTL
from valor.common.instance import Instance

ROBOT, OPERATOR, STRANGER = (f"valor_{os.getpid()}_{name}" for name in "ros")
TIMEOUT = 120.0  # [s]
PROFILE = """\
description: ROS' side without a robot.
processes: [bifrostd, footstep_converter]
"""
# A client without code of the project: its plan is rejected, which needs messages in both directions.
CLIENT = """\
import sys, rclpy
from rclpy.action import ActionClient
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
rclpy.init()
node = rclpy.create_node("operator")
client = ActionClient(node, ExecuteStepPlan, "/far/robot_controllers/footstep_controller/execute_step_plan")
if not client.wait_for_server(float(sys.argv[1])):
    sys.exit(3)
sent = client.send_goal_async(ExecuteStepPlan.Goal())
rclpy.spin_until_future_complete(node, sent)
ended = sent.result().get_result_async()
rclpy.spin_until_future_complete(node, ended)
print(ended.result().result.status.status)
"""


def run(*command: str, check: bool = True, environment: Mapping[str, str] | None = None) -> str:
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=2 * TIMEOUT, check=False)
    assert not check or result.returncode == 0, f"{' '.join(command)}:\n{result.stdout}{result.stderr}"
    return result.stdout


def inside(computer: str) -> tuple[str, ...]:
    return ("ip", "netns", "exec", computer)


@pytest.fixture
def computers() -> Iterator[None]:
    """The robot's computer, with a cable to each of two others: 10.213.1.1 to .2, 10.213.2.1 to .2."""
    with ExitStack() as stack:
        try:
            for name in (ROBOT, OPERATOR, STRANGER):
                run("ip", "netns", "add", name)
                stack.callback(subprocess.run, ["ip", "netns", "delete", name], check=False)
                run(*inside(name), "ip", "link", "set", "lo", "up")
            for number, other in ((1, OPERATOR), (2, STRANGER)):
                ends = [f"v{os.getpid()}{number}{end}" for end in "ab"]
                run("ip", "link", "add", ends[0], "type", "veth", "peer", "name", ends[1])
                for at, (computer, end) in enumerate(zip((ROBOT, other), ends, strict=True), 1):
                    run("ip", "link", "set", end, "netns", computer)
                    run(*inside(computer), "ip", "address", "add", f"10.213.{number}.{at}/24", "dev", end)
                    run(*inside(computer), "ip", "link", "set", end, "up")
        except (AssertionError, OSError) as error:
            pytest.skip(f"no network namespaces with cables between them here: {str(error).splitlines()[-1]}")
        yield


def test_a_named_peer_reaches_the_robot_and_another_network_does_not(computers: None) -> None:
    with tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as folder:
        profile = Path(folder, "ros.yaml")
        profile.write_text(PROFILE)
        robot = os.environ | {"VALOR_HOME": folder, "VALOR_INSTANCE": "far"}
        up = ("up", "--profile", str(profile), "--namespace", "far", "--peers", "10.213.1.2")
        refused = subprocess.run(
            [*inside(ROBOT), str(VALORCTL), *up[:-1], "10.214.0.1"], env=robot, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        assert refused.returncode == 1 and "is not reached from here" in refused.stderr, refused.stderr
        try:
            assert "peers 10.213.1.2" in run(*inside(ROBOT), str(VALORCTL), *up, environment=robot)
            domain = Instance("far", Path(folder)).settings().ros_domain_id
            client = {k: v for k, v in os.environ.items() if not k.startswith(("ROS_", "FAST", "VALOR"))}
            client |= {"ROS_DOMAIN_ID": str(domain)}
            script = (sys.executable, "-c", CLIENT)
            status = run(*inside(OPERATOR), *script, str(TIMEOUT), environment=client)
            assert int(status) != 0, "an empty plan is rejected, with flags"
            # Its timeout is longer than the other client needed.
            lost = subprocess.run([*inside(STRANGER), *script, "5.0"], env=client, capture_output=True, check=False)
            assert lost.returncode == 3, "a computer that is no peer, on another network, found the robot"
        finally:
            run(*inside(ROBOT), str(VALORCTL), "down", environment=robot)
