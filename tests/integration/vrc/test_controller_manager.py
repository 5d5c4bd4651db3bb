"""Controllers are listed and switched, and parameters changed, as ros2_control's tools do it."""

from __future__ import annotations

import math
from typing import Any

from controller_manager_msgs.srv import ListControllers, LoadController, SwitchController
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter

from harness.system import RosClient
from tests.integration.vrc.vrc_system import (
    HOME,
    INVALID_GOAL,
    INVALID_JOINTS,
    PATH_TOLERANCE_VIOLATED,
    SUCCESSFUL,
    VRC,
    ask,
    errors,
    resting,
)


def test_the_controller_manager_lists_and_switches_within_the_control_mode(manipulating: RosClient) -> None:
    def listed() -> dict[str, Any]:
        answer = ask(manipulating, ListControllers, "/controller_manager/list_controllers")
        return {controller.name: controller for controller in answer.controller}

    def switch(strictness: int, **names: list[str]) -> Any:
        return ask(
            manipulating, SwitchController, "/controller_manager/switch_controller", strictness=strictness, **names
        )

    strict, best_effort = SwitchController.Request.STRICT, SwitchController.Request.BEST_EFFORT
    arm = "right_arm_traj_controller"
    before = listed()
    assert before[arm].state == "active"
    assert before[arm].type == "joint_trajectory_controller/JointTrajectoryController"
    assert "r_elbow_pitch/position" in before[arm].claimed_interfaces
    assert before["pelvis_traj_controller"].state == "inactive"
    assert before["control_mode_controller"].state == before["left_leg_traj_controller"].state == "active"
    refused = switch(strict, activate_controllers=["pelvis_traj_controller"], deactivate_controllers=[arm])
    assert not refused.ok and "pelvis_traj_controller" in refused.message, refused
    assert "stand_manipulate" in refused.message and listed()[arm].state == "active", "strict: all or nothing"
    assert not switch(strict, deactivate_controllers=["no_controller"]).ok
    partly = switch(best_effort, activate_controllers=["pelvis_traj_controller", arm])
    assert partly.ok and "pelvis_traj_controller" in partly.message

    held = resting(manipulating)
    assert switch(strict, deactivate_controllers=[arm]).ok
    assert listed()[arm].state == "inactive" and not listed()[arm].claimed_interfaces
    answer = manipulating.follow("right_arm", [(2.0, HOME)])
    assert answer.result.error_code == INVALID_GOAL and "not active" in answer.result.error_string
    assert switch(strict, activate_controllers=[arm]).ok
    assert listed()[arm].state == "active"
    assert max(errors(manipulating, {name: held[name] for name in HOME}).values()) < 0.02
    answer = manipulating.follow("right_arm", [(2.0, HOME)])
    assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
    assert not ask(manipulating, LoadController, "/controller_manager/load_controller", name=arm).ok


def test_parameters_change_at_run_time_and_bad_values_are_refused(manipulating: RosClient) -> None:
    prefix = "right_arm_traj_controller"

    def change(name: str, value: Any) -> Any:
        parameter = Parameter(f"{prefix}.{name}", value=value).to_parameter_msg()
        answer = ask(manipulating, SetParameters, f"/{VRC}/set_parameters", parameters=[parameter])
        return answer.results[0]

    names = [f"{prefix}.constraints.goal_time"]
    (described,) = ask(manipulating, DescribeParameters, f"/{VRC}/describe_parameters", names=names).descriptors
    assert described.description and described.floating_point_range[0].from_value == 0.0
    for name, value in (
        ("constraints.goal_time", -1.0),
        ("constraints.r_elbow_pitch.goal", math.nan),
        ("action_monitor_rate", 0.0),
        ("allow_partial_joints_goal", "yes"),
    ):
        refused = change(name, value)
        assert not refused.successful and ("range" in refused.reason or "BOOL" in refused.reason), refused
    partial = {"r_elbow_pitch": HOME["r_elbow_pitch"] + 0.2}
    assert manipulating.follow("right_arm", [(1.0, partial)]).result.error_code == INVALID_JOINTS
    assert change("allow_partial_joints_goal", True).successful
    try:
        answer = manipulating.follow("right_arm", [(1.0, partial)])
        assert answer.result.error_code == SUCCESSFUL, answer.result.error_string
        # A tolerance that nothing meets.
        assert change("constraints.r_elbow_pitch.trajectory", 1e-9).successful
        answer = manipulating.follow("right_arm", [(1.0, {"r_elbow_pitch": HOME["r_elbow_pitch"]})])
        assert answer.result.error_code == PATH_TOLERANCE_VIOLATED, answer.result
        assert "path tolerance violation: r_elbow_pitch" in answer.result.error_string
    finally:
        assert change("constraints.r_elbow_pitch.trajectory", 0.3).successful
        assert change("allow_partial_joints_goal", False).successful
