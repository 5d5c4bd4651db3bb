"""What tools made for ros2_control look for, by their sources, is there, and works under the names they make up.

MoveIt's ``Ros2ControlManager`` (moveit_ros_control_interface) and ros2_controllers' ``rqt_joint_trajectory_controller``
ask a controller manager for its controllers, and take each controller's interfaces to stand beside it, under its name.
Neither asks for a parameter of a controller.
"""

from __future__ import annotations

from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from controller_manager_msgs.srv import ListControllers
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.vrc_system import FORWARD, HOME, PATIENCE, SUCCESSFUL, ask, errors

CONTROL, MANAGER = "control_msgs", "controller_manager_msgs/srv"
RQT_SERVICES = {  # utils.py, cm_services: a controller manager is what has all of them
    "list_controllers": f"{MANAGER}/ListControllers",
    "list_controller_types": f"{MANAGER}/ListControllerTypes",
    "load_controller": f"{MANAGER}/LoadController",
    "unload_controller": f"{MANAGER}/UnloadController",
    "switch_controller": f"{MANAGER}/SwitchController",
    "reload_controller_libraries": f"{MANAGER}/ReloadControllerLibraries",
}
MOVEIT_SERVICES = ("list_controllers", "switch_controller")  # controller_manager_plugin.cpp, initialize()
MOVEIT_TYPE = "joint_trajectory_controller/JointTrajectoryController"  # for which it has a handle
ACTION = "follow_joint_trajectory"  # joint_trajectory_controller_plugin.cpp
RQT_STATE, RQT_COMMAND = "controller_state", "joint_trajectory"  # joint_trajectory_controller.py, _load_jtc()


def beside(manager: str, controller: str) -> str:
    """Where both tools take a controller to be: one level above the controller manager."""
    return f"{manager.rsplit('/', 1)[0]}/{controller}"


@pytest.fixture
def manager(manipulating: RosClient) -> str:
    """The one that rqt finds: a name before ``/list_controllers`` that has all services, each with its type."""
    services = dict(manipulating.node.get_service_names_and_types())
    listing = [name.split("/list_controllers")[0] for name in services if "/list_controllers" in name]
    found = [each for each in listing if all(f"{each}/{name}" in services for name in RQT_SERVICES)]
    assert len(found) == 1
    for name, kind in RQT_SERVICES.items():
        assert services[f"{found[0]}/{name}"][0] == kind
    assert set(MOVEIT_SERVICES) <= set(RQT_SERVICES)
    return str(found[0])


@pytest.fixture
def controllers(manipulating: RosClient, manager: str) -> dict[str, Any]:
    """What the controller manager lists, by name."""
    return {each.name: each for each in ask(manipulating, ListControllers, f"{manager}/list_controllers").controller}


def test_every_trajectory_controller_is_where_the_tools_look(
    manipulating: RosClient, manager: str, controllers: dict[str, Any]
) -> None:
    topics = dict(manipulating.node.get_topic_names_and_types())
    services = dict(manipulating.node.get_service_names_and_types())
    handled = [each for each in controllers.values() if each.type == MOVEIT_TYPE]
    assert {"left_arm_traj_controller", "right_arm_traj_controller", "neck_traj_controller"} <= {
        c.name for c in handled
    }
    assert not any(each.chain_connections for each in handled), "MoveIt would take them out"
    for each in handled:
        base = beside(manager, each.name)
        assert services[f"{base}/{ACTION}/_action/send_goal"] == [f"{CONTROL}/action/FollowJointTrajectory_SendGoal"]
        assert services[f"{base}/query_state"] == [f"{CONTROL}/srv/QueryTrajectoryState"]
        assert topics[f"{base}/{RQT_STATE}"] == [f"{CONTROL}/msg/JointTrajectoryControllerState"]
        assert topics[f"{base}/{RQT_COMMAND}"] == ["trajectory_msgs/msg/JointTrajectory"]
        # MoveIt has the joints from these, rqt from the state's.
        commanded = {name.partition("/")[0] for name in each.required_command_interfaces}
        measured = {name.rpartition("/")[0] for name in each.required_state_interfaces if name.endswith("/position")}
        assert commanded == measured != set()
    arm = controllers["right_arm_traj_controller"]
    assert arm.state == "active" and {name.partition("/")[0] for name in arm.claimed_interfaces} == set(HOME)


def test_moveits_goal_and_rqts_slider_move_the_arm(
    manipulating: RosClient, manager: str, controllers: dict[str, Any]
) -> None:
    ros, name = manipulating, "right_arm_traj_controller"
    base = beside(manager, name)

    def point(target: dict[str, float], seconds: int) -> Any:
        return JointTrajectoryPoint(positions=list(target.values()), time_from_start=Duration(sec=seconds))

    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = list(FORWARD)
    goal.trajectory.points = [point(FORWARD, 2)]
    client = ActionClient(ros.node, FollowJointTrajectory, f"{base}/{ACTION}")
    try:
        assert ros._run(client, goal, PATIENCE).result.error_code == SUCCESSFUL
    finally:
        ros._call(client.destroy)
    slider = ros.node.create_publisher(JointTrajectory, f"{base}/{RQT_COMMAND}", 1)
    wait_until(lambda: slider.get_subscription_count() > 0, PATIENCE, "the controller to listen")
    slider.publish(JointTrajectory(joint_names=list(HOME), points=[point(HOME, 2)]))
    wait_until(lambda: max(errors(ros, HOME).values()) < 0.02, PATIENCE, "the arm at home")
    ros.destroy(ros.node.destroy_publisher, slider)
