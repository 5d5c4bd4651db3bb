"""``up --ros-commands none``: ROS 2 looks on, who commands there is told why nothing happens, and valorctl commands."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from controller_manager_msgs.srv import SwitchController
from geometry_msgs.msg import Twist
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from std_msgs.msg import Empty
from valor_msgs.msg import Rejection
from vigir_footstep_planning_msgs.msg import StepPlan

import bifrost
from harness.instance import RunningInstance
from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import HOME, PATIENCE, VRC, Topic, ask, go, publish
from valor.common.errors import ConfigurationError
from valor.common.messages import ModeStatus
from valor.common.topics import MOTION_STATE
from valor.valorctl.drive import control_mode

WHY = "commands on ROS 2 are rejected: up with --ros-commands none"
CONVERTER = "footstep_converter"


def restart(system: RunningInstance, ros_commands: str) -> None:
    system.configure(ros_commands=ros_commands)
    for process in (VRC, CONVERTER):
        system.stop(process)
        system.start(process)
    for process in (VRC, CONVERTER):
        system.wait_ready(process, PATIENCE)


@pytest.fixture(scope="module")
def unobeyed(system: RunningInstance, ros: RosClient) -> Iterator[RosClient]:
    """A client of a robot that stands, and obeys none."""
    restart(system, "none")
    yield ros
    restart(system, "all")
    go(ros, "stand")


def test_whoever_commands_on_ros_is_refused_and_told_why(
    system: RunningInstance, unobeyed: RosClient, node: bifrost.Node
) -> None:
    states = MOTION_STATE.subscriber(node)
    before = states.receive(PATIENCE)
    rejections = Topic(unobeyed, Rejection, "/flor/controller/rejection")

    result = unobeyed.change_mode("freeze")
    assert result.status & ModeStatus.MODE_REJECTED and result.current_control_mode == "stand"
    assert f"control mode freeze rejected: {WHY}" in system.log(VRC)
    assert unobeyed.follow("right_arm", [(2.0, HOME)]).result.error_string == WHY
    switch = {"deactivate_controllers": ["neck_traj_controller"], "strictness": SwitchController.Request.STRICT}
    answer = ask(unobeyed, SwitchController, "/controller_manager/switch_controller", **switch)
    assert (answer.ok, answer.message) == (False, WHY)
    rate = Parameter(
        name="neck_traj_controller.action_monitor_rate",
        value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=5.0),
    )
    [told] = ask(unobeyed, SetParameters, f"/{VRC}/set_parameters", parameters=[rate]).results
    assert (told.successful, told.reason) == (False, WHY)
    for topic, message in (("/cmd_vel", Twist()), ("/flor/controller/soft_stop", Empty())):
        publish(unobeyed, topic, message)
        wait_until(lambda t=topic: (t, WHY) in {(m.topic, m.reason) for m in rejections.messages}, PATIENCE, topic)  # type: ignore[misc]
    publish(unobeyed, "/robot_controllers/footstep_controller/execute_step_plan", StepPlan())
    wait_until(lambda: f"plan rejected: {WHY}" in system.log(CONVERTER), PATIENCE, "the plan's refusal")

    after = states.receive(PATIENCE)
    assert before and after and (before.message.behavior, after.message.behavior) == ("stand", "stand")
    states.close()
    rejections.close()


def test_valorctl_commands_by_the_motion_manager(system: RunningInstance, unobeyed: RosClient) -> None:
    for mode in ("stand_manipulate", "stand"):
        change = control_mode.change(system.instance, mode)
        assert change.reached and change.current == mode
    control_mode.change(system.instance, "stand_manipulate")
    refused = control_mode.change(system.instance, "stand_prep")
    assert (refused.reached, refused.current) == (False, "stand_manipulate")
    assert "stand_prep" in refused.describe() and refused.reason
    with pytest.raises(ConfigurationError, match="control mode 'manipulate': expected one of"):
        control_mode.change(system.instance, "manipulate")
    assert control_mode.change(system.instance, "stand").reached
