"""The compiled packages interoperate: names, fields and constants are the public ones, and rclpy carries them."""

import os
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointComponentTolerance, JointTolerance, JointTrajectoryControllerState
from control_msgs.srv import QueryTrajectoryState
from controller_manager_msgs.msg import ChainConnection, ControllerState, HardwareComponentState, HardwareInterface
from controller_manager_msgs.srv import (
    ListControllers,
    ListControllerTypes,
    ListHardwareComponents,
    ListHardwareInterfaces,
    SetHardwareComponentState,
    SwitchController,
)
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from tf2_msgs.action import LookupTransform
from tf2_msgs.msg import TF2Error, TFMessage
from trajectory_msgs.msg import JointTrajectoryPoint
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import (
    ErrorStatus,
    Feet,
    Foot,
    FootstepExecutionStatus,
    Step,
    StepPlan,
    StepPlanFeedback,
)
from vigir_humanoid_control_msgs.action import ChangeControlMode
from vigir_humanoid_control_msgs.msg import ControlModeStatus, VigirControlModeCommand

from valor.common.resources import middleware_profile

POINT, MULTI = "trajectory_msgs/JointTrajectoryPoint", "trajectory_msgs/MultiDOFJointTrajectoryPoint"
TOLERANCES = {"position": "double", "velocity": "double", "acceleration": "double"}
MANAGER = "controller_manager_msgs"
HEADER = {"header": "std_msgs/Header"}
VIGIR = "vigir_footstep_planning_msgs"
FIELDS = {
    FollowJointTrajectory.Goal: {
        "trajectory": "trajectory_msgs/JointTrajectory",
        "multi_dof_trajectory": "trajectory_msgs/MultiDOFJointTrajectory",
        "path_tolerance": "sequence<control_msgs/JointTolerance>",
        "component_path_tolerance": "sequence<control_msgs/JointComponentTolerance>",
        "goal_tolerance": "sequence<control_msgs/JointTolerance>",
        "component_goal_tolerance": "sequence<control_msgs/JointComponentTolerance>",
        "goal_time_tolerance": "builtin_interfaces/Duration",
    },
    FollowJointTrajectory.Result: {"error_code": "int32", "error_string": "string"},
    FollowJointTrajectory.Feedback: HEADER
    | {"joint_names": "sequence<string>", "desired": POINT, "actual": POINT, "error": POINT}
    | {"multi_dof_joint_names": "sequence<string>"}
    | {"multi_dof_desired": MULTI, "multi_dof_actual": MULTI, "multi_dof_error": MULTI},
    JointTolerance: {"name": "string"} | TOLERANCES,
    JointComponentTolerance: {"joint_name": "string", "component": "uint16"} | TOLERANCES,
    JointTrajectoryControllerState: HEADER
    | {"joint_names": "sequence<string>"}
    | dict.fromkeys(("reference", "feedback", "error", "output"), POINT)
    | {"multi_dof_joint_names": "sequence<string>"}
    | dict.fromkeys(("multi_dof_reference", "multi_dof_feedback", "multi_dof_error", "multi_dof_output"), MULTI)
    | {"speed_scaling_factor": "double"},
    QueryTrajectoryState.Request: {"time": "builtin_interfaces/Time"},
    QueryTrajectoryState.Response: {"success": "boolean", "message": "string", "name": "sequence<string>"}
    | dict.fromkeys(("position", "velocity", "acceleration"), "sequence<double>"),
    ChainConnection: {"name": "string", "reference_interfaces": "sequence<string>"},
    ControllerState: {"name": "string", "state": "string", "type": "string", "is_async": "boolean"}
    | {"update_rate": "uint16"}
    | dict.fromkeys(
        ("claimed_interfaces", "required_command_interfaces", "required_state_interfaces"), "sequence<string>"
    )
    | {"is_chainable": "boolean", "is_chained": "boolean"}
    | dict.fromkeys(("exported_state_interfaces", "reference_interfaces"), "sequence<string>")
    | {"chain_connections": f"sequence<{MANAGER}/ChainConnection>"},
    HardwareInterface: {"name": "string", "data_type": "string", "is_available": "boolean", "is_claimed": "boolean"},
    HardwareComponentState: {"name": "string", "type": "string", "is_async": "boolean", "rw_rate": "uint16"}
    | {"class_type": "string", "plugin_name": "string", "state": "lifecycle_msgs/State"}
    | dict.fromkeys(("command_interfaces", "state_interfaces"), f"sequence<{MANAGER}/HardwareInterface>"),
    SwitchController.Request: dict.fromkeys(("activate_controllers", "deactivate_controllers"), "sequence<string>")
    | {"strictness": "int32", "activate_asap": "boolean", "timeout": "builtin_interfaces/Duration"},
    SwitchController.Response: {"ok": "boolean", "message": "string"},
    ListControllers.Response: {"controller": f"sequence<{MANAGER}/ControllerState>"},
    ListControllerTypes.Response: dict.fromkeys(("types", "base_classes"), "sequence<string>"),
    ListHardwareComponents.Response: {"component": f"sequence<{MANAGER}/HardwareComponentState>"},
    ListHardwareInterfaces.Response: dict.fromkeys(
        ("command_interfaces", "state_interfaces"), f"sequence<{MANAGER}/HardwareInterface>"
    ),
    SetHardwareComponentState.Request: {"name": "string", "target_state": "lifecycle_msgs/State"},
    SetHardwareComponentState.Response: {"ok": "boolean", "state": "lifecycle_msgs/State"},
    TFMessage: {"transforms": "sequence<geometry_msgs/TransformStamped>"},
    TF2Error: {"error": "uint8", "error_string": "string"},
    LookupTransform.Goal: {
        "target_frame": "string",
        "source_frame": "string",
        "source_time": "builtin_interfaces/Time",
        "timeout": "builtin_interfaces/Duration",
        "target_time": "builtin_interfaces/Time",
        "fixed_frame": "string",
        "advanced": "boolean",
    },
    ControlModeStatus: HEADER
    | {"requested_control_mode": "string", "current_control_mode": "string", "status": "uint32"},
    VigirControlModeCommand: HEADER | {"requested_control_mode": "string"},
    ChangeControlMode.Goal: {"mode_request": "string"},
    ChangeControlMode.Result: {"result": "vigir_humanoid_control_msgs/ControlModeStatus"},
    ChangeControlMode.Feedback: {"feedback": "vigir_humanoid_control_msgs/ControlModeStatus"},
    Foot: HEADER | {"foot_index": "uint8", "pose": "geometry_msgs/Pose"},
    Feet: HEADER | {"left": f"{VIGIR}/Foot", "right": f"{VIGIR}/Foot"},
    Step: HEADER
    | {"foot": f"{VIGIR}/Foot", "step_index": "int32", "cost": "float", "risk": "float"}
    | dict.fromkeys(("valid", "colliding", "locked", "modified"), "boolean")
    | dict.fromkeys(("sway_duration", "step_duration", "swing_height"), "float")
    | {"data": "sequence<uint8>"},
    StepPlan: HEADER
    | {"parameter_set_name": "std_msgs/String", "start": f"{VIGIR}/Feet", "goal": f"{VIGIR}/Feet"}
    | {"steps": f"sequence<{VIGIR}/Step>", "mode": "uint8", "data": "sequence<uint8>"},
    StepPlanFeedback: HEADER | {"steps": f"sequence<{VIGIR}/Step>", "data": "sequence<uint8>"},
    ErrorStatus: {"error": "uint32", "error_msg": "string", "warning": "uint32", "warning_msg": "string"},
    FootstepExecutionStatus: HEADER | {"status": "uint32"},
    ExecuteStepPlan.Goal: {"step_plan": f"{VIGIR}/StepPlan"},
    ExecuteStepPlan.Result: {"status": f"{VIGIR}/FootstepExecutionStatus", "controller_state": "int8"},
    ExecuteStepPlan.Feedback: HEADER
    | {"controller_state": "int8", "status": f"{VIGIR}/ErrorStatus", "queue_size": "int32"}
    | dict.fromkeys(("first_queued_step_index", "last_queued_step_index"), "int32")
    | dict.fromkeys(("last_performed_step_index", "currently_executing_step_index"), "int32")
    | dict.fromkeys(("first_changeable_step_index", "stepping_status"), "int32")
    | {"feedback": f"{VIGIR}/StepPlanFeedback"},
}
CONSTANTS = {
    SwitchController.Request: "BEST_EFFORT 1 STRICT 2 AUTO 3 FORCE_AUTO 4",
    FollowJointTrajectory.Result: "SUCCESSFUL 0 INVALID_GOAL -1 INVALID_JOINTS -2 OLD_HEADER_TIMESTAMP -3 "
    "PATH_TOLERANCE_VIOLATED -4 GOAL_TOLERANCE_VIOLATED -5",
    JointComponentTolerance: "X_AXIS 1 Y_AXIS 2 Z_AXIS 3 TRANSLATION 4 ROTATION 5",
    TF2Error: "NO_ERROR 0 LOOKUP_ERROR 1 CONNECTIVITY_ERROR 2 EXTRAPOLATION_ERROR 3 INVALID_ARGUMENT_ERROR 4 "
    "TIMEOUT_ERROR 5 TRANSFORM_ERROR 6",
    ControlModeStatus: "NO_ERROR 0 MODE_ACCEPTED 1 MODE_REJECTED 2 MODE_PREEMPTED 4 MODE_PROCESSING 8 "
    "MODE_DUPLICATE 16 EXTERNAL_CHANGE 32 ERR_UNKNOWN 256 ERR_CONTROLLER_NOT_READY 512 "
    "ERR_INVALID_BEHAVIOR_MODE 1024 ERR_INVALID_TRANSITION 2048 ERR_PRIOR_COMMAND_IN_PROGRESS 4096",
    Foot: "LEFT 0 RIGHT 1",
    FootstepExecutionStatus: "NO_ERROR 0 REACHED_GOAL 1 WAITING_FOR_ATLAS 2 EXECUTING_STEP_PLAN 4 "
    "PREMATURE_HALT 8 UPDATED_STEP_PLAN 16 EMERGENCY_HALT 32 ERR_UNKNOWN 256 ERR_EMPTY_PLAN 512 "
    "ERR_INVALID_BEHAVIOR_MODE 1024 ERR_INVALID_PLAN 2048 ERR_INVALID_INCONSISTENT_INDICES 4096 "
    "ERR_INCONSISTENT_STEP_PLAN 8192 ERR_CONTROLLER_NOT_READY 16384 ERR_FALLEN 32768 "
    "ERR_NON_ZERO_INITIAL_STEP 65536 ERR_NEXT_ERROR 131072",
    ErrorStatus: "NO_ERROR 0 ERR_UNKNOWN 1 ERR_NO_SOLUTION 2 ERR_INVALID_START 4 ERR_INVALID_GOAL 8 "
    "ERR_INVALID_GRID_MAP 16 ERR_INVALID_TERRAIN_MODEL 32 ERR_INVALID_STEP 64 ERR_INCONSISTENT_STEP_PLAN 128 "
    "ERR_INVALID_PARAMETERS 256 ERR_NO_PLUGIN_AVAILABLE 512 ERR_INCONSISTENT_REQUEST 1024 "
    "NO_WARNING 0 WARN_UNKNOWN 1 WARN_INCOMPLETE_STEP_PLAN 2 WARN_INVALID_STEP_PLAN 4",
    ExecuteStepPlan.Feedback: "NOT_READY 0 READY 1 ACTIVE 2 PAUSED 3 FINISHED 4 FAILED 5",
}

SERVER = """
    import time

    import rclpy
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionServer
    from valor_msgs.msg import JointSetpoints

    FEEDBACK = "arm/follow_joint_trajectory/_action/feedback"
    rclpy.init()
    node = rclpy.create_node("server")
    setpoints = node.create_publisher(JointSetpoints, "setpoints", 10)

    def execute(goal):
        request = goal.request
        last = request.trajectory.points[-1]
        feedback = FollowJointTrajectory.Feedback(joint_names=request.trajectory.joint_names, desired=last)
        feedback.header.frame_id = request.path_tolerance[0].name
        given_up = time.monotonic() + 20.0  # nobody hears what is published before they have found each other
        while not (setpoints.get_subscription_count() and node.count_subscribers(FEEDBACK)):
            assert time.monotonic() < given_up
            time.sleep(0.01)
        goal.publish_feedback(feedback)
        message = JointSetpoints(bifrost_sequence=2**64 - 1, names=request.trajectory.joint_names,
                                 position=last.positions, time=-(2**63))
        message.header.frame_id = "valor_ros_controller"
        setpoints.publish(message)
        goal.succeed()
        return FollowJointTrajectory.Result(
            error_code=FollowJointTrajectory.Result.GOAL_TOLERANCE_VIOLATED, error_string="r_elbow_pitch: 0.1 rad")

    server = ActionServer(node, FollowJointTrajectory, "arm/follow_joint_trajectory", execute)
    rclpy.spin(node)
"""


@pytest.mark.parametrize("message", FIELDS, ids=lambda message: message.__name__)
def test_fields_are_the_public_ones_in_their_order(message: Any) -> None:
    assert list(message.get_fields_and_field_types().items()) == list(FIELDS[message].items())


@pytest.mark.parametrize("message", CONSTANTS, ids=lambda message: message.__name__)
def test_constants_are_the_public_ones(message: type) -> None:
    words = CONSTANTS[message].split()
    expected = {name: int(value) for name, value in zip(words[::2], words[1::2], strict=True)}
    assert {name: getattr(message, name) for name in expected} == expected


@pytest.fixture
def node(ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Node, SingleThreadedExecutor]]:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ros_domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SYSTEM_DEFAULT")
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(middleware_profile()))
    context = Context()
    rclpy.init(context=context)
    made = rclpy.create_node("client", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(made)
    yield made, executor
    executor.shutdown()
    made.destroy_node()
    context.shutdown()


def test_an_action_and_a_message_cross_between_processes(node: tuple[Node, SingleThreadedExecutor]) -> None:
    ours, executor = node
    server = subprocess.Popen([sys.executable, "-c", textwrap.dedent(SERVER)], env=os.environ.copy())
    try:
        from valor_msgs.msg import JointSetpoints

        received: list[JointSetpoints] = []
        feedback: list[FollowJointTrajectory.Feedback] = []
        ours.create_subscription(JointSetpoints, "setpoints", received.append, 10)
        client = ActionClient(ours, FollowJointTrajectory, "arm/follow_joint_trajectory")
        assert client.wait_for_server(timeout_sec=20), "no action server"
        goal = FollowJointTrajectory.Goal()
        goal.trajectory.joint_names = ["r_elbow_pitch", "r_wrist_yaw"]
        goal.trajectory.points = [JointTrajectoryPoint(positions=[0.5, -1.25])]
        goal.path_tolerance = [JointTolerance(name="r_elbow_pitch", position=-1.0)]

        accepted = client.send_goal_async(goal, feedback_callback=lambda message: feedback.append(message.feedback))
        executor.spin_until_future_complete(accepted, timeout_sec=20)
        handle = accepted.result()
        assert handle is not None and handle.accepted
        done = handle.get_result_async()
        executor.spin_until_future_complete(done, timeout_sec=20)
        assert done.result() is not None, "no result"
        for _ in range(200):
            if received and feedback:
                break
            executor.spin_once(timeout_sec=0.1)

        result = done.result().result
        assert (result.error_code, result.error_string) == (-5, "r_elbow_pitch: 0.1 rad")
        assert feedback[0].header.frame_id == "r_elbow_pitch"
        assert list(feedback[0].desired.positions) == [0.5, -1.25]
        assert received[0].names == goal.trajectory.joint_names
        assert list(received[0].position) == [0.5, -1.25]
        assert (received[0].bifrost_sequence, received[0].time) == (2**64 - 1, -(2**63))
        assert received[0].header.frame_id == "valor_ros_controller"
    finally:
        server.kill()
        server.wait()
