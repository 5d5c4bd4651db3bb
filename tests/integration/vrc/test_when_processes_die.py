"""The VRC and those before it are killed, ended and started again: who waits is told, and the arms hold.

The last file of the folder, for it does not leave the system as it found it.
"""

from __future__ import annotations

import subprocess
import sys

from valor_msgs.msg import JointGains, Rejection

import bifrost
from harness.instance import RunningInstance
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import (
    EXTERNAL_CHANGE,
    FORWARD,
    HOME,
    NOT_READY,
    PATIENCE,
    REJECTED,
    STATUS_ABORTED,
    SUCCESSFUL,
    VRC,
    Topic,
    errors,
    publish,
    resting,
    send,
)
from valor.common.processes import BY_NAME, EXIT_CONFIGURATION
from valor.common.topics import MOTION_STATE, STATISTICS


def test_killed_it_comes_back_with_the_true_mode_and_the_arms_hold(
    system: RunningInstance, manipulating: RosClient, node: bifrost.Node
) -> None:
    held = resting(manipulating)
    system.kill(VRC)
    state = MOTION_STATE.subscriber(node)
    manipulating.reports.clear()
    system.start(VRC)
    system.wait_ready(VRC, PATIENCE)
    wait_until(lambda: manipulating.reports, PATIENCE, "a report of the restarted VRC")
    wait_until(lambda: manipulating.reports[-1].current_control_mode == "stand_manipulate", PATIENCE, "the true mode")
    assert manipulating.reports[-1].status == EXTERNAL_CHANGE
    received = state.receive(PATIENCE)
    assert received is not None and received.message.behavior == "stand_manipulate"
    state.close()
    assert max(errors(manipulating, {name: held[name] for name in FORWARD}).values()) < 0.05
    answer = manipulating.follow("right_arm", [(2.0, HOME)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string


def test_a_dead_motion_manager_aborts_goals_by_name_and_its_return_is_followed(
    system: RunningInstance, manipulating: RosClient
) -> None:
    handle = send(manipulating, FORWARD, 6.0)
    system.kill("motion_manager")
    try:
        answer = manipulating._wait(manipulating._call(handle.get_result_async), PATIENCE, "the end of the goal")
        assert answer.status == STATUS_ABORTED and "motion_manager is silent" in answer.result.error_string
        assert manipulating.change_mode("stand").status == REJECTED | NOT_READY
    finally:
        system.start("motion_manager")
    wait_until(
        lambda: manipulating.reports[-1].current_control_mode == "freeze",
        PATIENCE,
        "the mode of the restarted Motion Manager",
    )


def test_a_dead_comms_manager_is_named_and_its_return_is_followed(
    system: RunningInstance, ros: RosClient, node: bifrost.Node
) -> None:
    statistics = STATISTICS["valor_ros_controller"].subscriber(node)

    def detail() -> str:
        received = statistics.receive(1.0)
        return received.message.detail if received else ""

    system.kill("comms_manager")
    wait_until(lambda: "comms_manager" in detail(), PATIENCE, "the VRC to name the silent process")
    rejections = Topic(ros, Rejection, "/flor/controller/rejection", latched=True)
    gains = "/flor/controller/joint_gains"
    publish(ros, gains, JointGains())
    told = (gains, "comms_manager is silent")
    wait_until(lambda: told in {(m.topic, m.reason) for m in rejections.messages}, PATIENCE, "gains to be refused")
    system.start("comms_manager")
    system.wait_ready(VRC, PATIENCE)
    statistics.close()


def test_a_wrong_parameter_ends_it_with_one_line(system: RunningInstance, ros_domain: int) -> None:
    arguments, words = ("-p", "update_rate:=1000.0"), ("update_rate", "1000", "expected 1 to 500")
    command = [sys.executable, "-m", BY_NAME[VRC].module, "--ros-args", *arguments]
    environment = system.environment | {"ROS_DOMAIN_ID": str(ros_domain)}
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert result.returncode == EXIT_CONFIGURATION, result.stderr
    assert "Traceback" not in result.stderr, result.stderr
    lines = [line for line in result.stderr.splitlines() if "ERROR" in line]
    assert len(lines) == 1 and all(word in lines[0] for word in words), result.stderr


def test_sigterm_ends_it_in_order(system: RunningInstance) -> None:
    assert system.stop(VRC) == 0
    log = system.log(VRC)
    assert "Traceback" not in log, log
    assert "RTPS" not in log, log
    assert log.rstrip().endswith("stopped")
