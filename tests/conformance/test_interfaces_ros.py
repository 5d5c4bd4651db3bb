"""The compiled packages interoperate: names, fields and constants are the public ones, and rclpy carries them."""

import importlib
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectoryPoint

from valor.common.resources import middleware_profile

# The public definitions: a package's part, then types with their fields in order, ``~`` for the package, and constants.
PUBLIC = """
control_msgs.action
  FollowJointTrajectory.Goal: trajectory_msgs/JointTrajectory trajectory; trajectory_msgs/MultiDOFJointTrajectory
    multi_dof_trajectory; sequence<~/JointTolerance> path_tolerance; sequence<~/JointComponentTolerance>
    component_path_tolerance; sequence<~/JointTolerance> goal_tolerance; sequence<~/JointComponentTolerance>
    component_goal_tolerance; builtin_interfaces/Duration goal_time_tolerance
  FollowJointTrajectory.Result: int32 error_code; string error_string
  FollowJointTrajectory.Result = SUCCESSFUL 0 INVALID_GOAL -1 INVALID_JOINTS -2 OLD_HEADER_TIMESTAMP -3
    PATH_TOLERANCE_VIOLATED -4 GOAL_TOLERANCE_VIOLATED -5
  FollowJointTrajectory.Feedback: Header header; sequence<string> joint_names; trajectory_msgs/JointTrajectoryPoint
    desired actual error; sequence<string> multi_dof_joint_names; trajectory_msgs/MultiDOFJointTrajectoryPoint
    multi_dof_desired multi_dof_actual multi_dof_error
control_msgs.msg
  JointTolerance: string name; double position velocity acceleration
  JointComponentTolerance: string joint_name; uint16 component; double position velocity acceleration
  JointComponentTolerance = X_AXIS 1 Y_AXIS 2 Z_AXIS 3 TRANSLATION 4 ROTATION 5
  JointTrajectoryControllerState: Header header; sequence<string> joint_names; trajectory_msgs/JointTrajectoryPoint
    reference feedback error output; sequence<string> multi_dof_joint_names;
    trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_reference multi_dof_feedback multi_dof_error
    multi_dof_output; double speed_scaling_factor
control_msgs.srv
  QueryTrajectoryState_Request: builtin_interfaces/Time time
  QueryTrajectoryState_Response: boolean success; string message; sequence<string> name; sequence<double> position
    velocity acceleration
controller_manager_msgs.msg
  ChainConnection: string name; sequence<string> reference_interfaces
  ControllerState: string name state type; boolean is_async; uint16 update_rate; sequence<string> claimed_interfaces
    required_command_interfaces required_state_interfaces; boolean is_chainable is_chained; sequence<string>
    exported_state_interfaces reference_interfaces; sequence<~/ChainConnection> chain_connections
  HardwareInterface: string name data_type; boolean is_available is_claimed
  HardwareComponentState: string name type; boolean is_async; uint16 rw_rate; string class_type plugin_name;
    lifecycle_msgs/State state; sequence<~/HardwareInterface> command_interfaces state_interfaces
controller_manager_msgs.srv
  SwitchController_Request: sequence<string> activate_controllers deactivate_controllers; int32 strictness; boolean
    activate_asap; builtin_interfaces/Duration timeout
  SwitchController_Request = BEST_EFFORT 1 STRICT 2 AUTO 3 FORCE_AUTO 4
  SwitchController_Response: boolean ok; string message
  ListControllers_Response: sequence<~/ControllerState> controller
  ListControllerTypes_Response: sequence<string> types base_classes
  ListHardwareComponents_Response: sequence<~/HardwareComponentState> component
  ListHardwareInterfaces_Response: sequence<~/HardwareInterface> command_interfaces state_interfaces
  SetHardwareComponentState_Request: string name; lifecycle_msgs/State target_state
  SetHardwareComponentState_Response: boolean ok; lifecycle_msgs/State state
tf2_msgs.msg
  TFMessage: sequence<geometry_msgs/TransformStamped> transforms
  TF2Error: uint8 error; string error_string
  TF2Error = NO_ERROR 0 LOOKUP_ERROR 1 CONNECTIVITY_ERROR 2 EXTRAPOLATION_ERROR 3 INVALID_ARGUMENT_ERROR 4
    TIMEOUT_ERROR 5 TRANSFORM_ERROR 6
tf2_msgs.action
  LookupTransform.Goal: string target_frame source_frame; builtin_interfaces/Time source_time;
    builtin_interfaces/Duration timeout; builtin_interfaces/Time target_time; string fixed_frame; boolean advanced
vigir_humanoid_control_msgs.msg
  ControlModeStatus: Header header; string requested_control_mode current_control_mode; uint32 status
  ControlModeStatus = NO_ERROR 0 MODE_ACCEPTED 1 MODE_REJECTED 2 MODE_PREEMPTED 4 MODE_PROCESSING 8 MODE_DUPLICATE 16
    EXTERNAL_CHANGE 32 ERR_UNKNOWN 256 ERR_CONTROLLER_NOT_READY 512 ERR_INVALID_BEHAVIOR_MODE 1024
    ERR_INVALID_TRANSITION 2048 ERR_PRIOR_COMMAND_IN_PROGRESS 4096
  VigirControlModeCommand: Header header; string requested_control_mode
vigir_humanoid_control_msgs.action
  ChangeControlMode.Goal: string mode_request
  ChangeControlMode.Result: ~/ControlModeStatus result
  ChangeControlMode.Feedback: ~/ControlModeStatus feedback
vigir_footstep_planning_msgs.msg
  Foot: Header header; uint8 foot_index; geometry_msgs/Pose pose
  Foot = LEFT 0 RIGHT 1
  Feet: Header header; ~/Foot left right
  Step: Header header; ~/Foot foot; int32 step_index; float cost risk; boolean valid colliding locked modified; float
    sway_duration step_duration swing_height; sequence<uint8> data
  StepPlan: Header header; std_msgs/String parameter_set_name; ~/Feet start goal; sequence<~/Step> steps; uint8 mode;
    sequence<uint8> data
  StepPlanFeedback: Header header; sequence<~/Step> steps; sequence<uint8> data
  ErrorStatus: uint32 error; string error_msg; uint32 warning; string warning_msg
  ErrorStatus = NO_ERROR 0 ERR_UNKNOWN 1 ERR_NO_SOLUTION 2 ERR_INVALID_START 4 ERR_INVALID_GOAL 8 ERR_INVALID_GRID_MAP
    16 ERR_INVALID_TERRAIN_MODEL 32 ERR_INVALID_STEP 64 ERR_INCONSISTENT_STEP_PLAN 128 ERR_INVALID_PARAMETERS 256
    ERR_NO_PLUGIN_AVAILABLE 512 ERR_INCONSISTENT_REQUEST 1024 NO_WARNING 0 WARN_UNKNOWN 1 WARN_INCOMPLETE_STEP_PLAN 2
    WARN_INVALID_STEP_PLAN 4
  FootstepExecutionStatus: Header header; uint32 status
  FootstepExecutionStatus = NO_ERROR 0 REACHED_GOAL 1 WAITING_FOR_ATLAS 2 EXECUTING_STEP_PLAN 4 PREMATURE_HALT 8
    UPDATED_STEP_PLAN 16 EMERGENCY_HALT 32 ERR_UNKNOWN 256 ERR_EMPTY_PLAN 512 ERR_INVALID_BEHAVIOR_MODE 1024
    ERR_INVALID_PLAN 2048 ERR_INVALID_INCONSISTENT_INDICES 4096 ERR_INCONSISTENT_STEP_PLAN 8192
    ERR_CONTROLLER_NOT_READY 16384 ERR_FALLEN 32768 ERR_NON_ZERO_INITIAL_STEP 65536 ERR_NEXT_ERROR 131072
vigir_footstep_planning_msgs.action
  ExecuteStepPlan.Goal: ~/StepPlan step_plan
  ExecuteStepPlan.Result: ~/FootstepExecutionStatus status; int8 controller_state
  ExecuteStepPlan.Feedback: Header header; int8 controller_state; ~/ErrorStatus status; int32 queue_size
    first_queued_step_index last_queued_step_index last_performed_step_index currently_executing_step_index
    first_changeable_step_index stepping_status; ~/StepPlanFeedback feedback
  ExecuteStepPlan.Feedback = NOT_READY 0 READY 1 ACTIVE 2 PAUSED 3 FINISHED 4 FAILED 5
"""


def public() -> Iterator[tuple[str, str, Any, list[str]]]:
    module = ""
    for row in re.sub(r"\n {4}", " ", PUBLIC).strip("\n").splitlines():
        if not row.startswith(" "):
            module = row
            continue
        name, kind, words = re.split(r"(:| =) ", row.strip(), maxsplit=1)
        message: Any = importlib.import_module(module)
        for part in name.split("."):
            message = getattr(message, part)
        yield name, kind, message, words.replace("~", module.partition(".")[0]).split("; " if kind == ":" else None)


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


@pytest.mark.parametrize(("name", "kind", "message", "parts"), public())
def test_fields_and_constants_are_the_public_ones(name: str, kind: str, message: Any, parts: list[str]) -> None:
    if kind == ":":
        groups = [part.replace("Header ", "std_msgs/Header ").split() for part in parts]
        fields = [(field, type_) for type_, *fields in groups for field in fields]
        assert list(message.get_fields_and_field_types().items()) == fields, name
    else:
        expected = {name: int(value) for name, value in zip(parts[::2], parts[1::2], strict=True)}
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
        assert feedback[0].header.frame_id == "r_elbow_pitch" and list(feedback[0].desired.positions) == [0.5, -1.25]
        assert received[0].names == goal.trajectory.joint_names and list(received[0].position) == [0.5, -1.25]
        assert (received[0].bifrost_sequence, received[0].time) == (2**64 - 1, -(2**63))
        assert received[0].header.frame_id == "valor_ros_controller"
    finally:
        server.kill()
        server.wait()
