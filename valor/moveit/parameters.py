"""MoveIt's parameters: how fast joints may go, who solves for poses, who executes.

Numbers are ROS parameters of a type each: what is a double must be written as one.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import valor
from valor.common.document import Document
from valor.moveit.groups import Group
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription

CONTROLLERS = Path(valor.__file__).parent / "valor_ros_controller" / "controllers.yaml"
KDL = "kdl_kinematics_plugin/KDLKinematicsPlugin"
POSE = 6  # joints by which any pose of a tip can be asked for
SCALING = 0.5  # of speeds and accelerations, unless a request says otherwise


def joint_limits(robot: RobotDescription) -> dict[str, Any]:
    """``joint_limits.yaml``: what the VRC accepts, as commanded."""
    limits = CommandedLimits.of_joints(robot)
    return {
        "default_velocity_scaling_factor": SCALING,
        "default_acceleration_scaling_factor": SCALING,
        "joint_limits": {
            name: {
                "has_velocity_limits": True,
                "max_velocity": float(limits.velocity[i]),
                "has_acceleration_limits": True,
                "max_acceleration": float(limits.acceleration[i]),
            }
            for i, name in enumerate(robot.joints)
        },
    }


def kinematics(limbs: Mapping[str, Group]) -> dict[str, Any]:
    """``kinematics.yaml``: KDL, which comes with MoveIt; for limbs of fewer than six joints for places alone."""
    solved = [limb for limb in limbs.values() if limb.tip and limb.name.endswith(("_arm", "_leg"))]
    return {
        limb.name: {
            "kinematics_solver": KDL,
            "kinematics_solver_search_resolution": 0.005,
            "kinematics_solver_timeout": 0.05,  # [s]
        }
        | ({} if len(limb.joints) >= POSE else {"position_only_ik": True})
        for limb in solved
    }


def controllers(limbs: Mapping[str, Group]) -> dict[str, Any]:
    """``moveit_controllers.yaml``: the VRC's controllers that take goals, by whose names MoveIt finds their actions.

    Which of them run is the control mode's business and not MoveIt's, so the simple manager has them, which assumes
    that they do; one that does not refuses the goal and says why.

    Raises:
        ConfigurationError: the VRC's table cannot be read.
    """
    document = Document.load(CONTROLLERS)
    try:
        table: dict[str, dict[str, Any]] = document.content["joint_controllers"]  # type: ignore[index]
    except (KeyError, TypeError):
        raise document.error(["joint_controllers"], "expected, but missing") from None
    served = {
        name: [joint for group in controller["groups"] if group in limbs for joint in limbs[group].joints]
        for name, controller in table.items()
    }
    served = {name: joints for name, joints in served.items() if joints}
    return {
        "trajectory_execution": {
            "execution_duration_monitoring": True,
            "allowed_execution_duration_scaling": 1.5,  # the robot's clock may be slower than MoveIt's
            "allowed_goal_duration_margin": 2.5,  # beyond the controllers' goal_time [s]
            "allowed_start_tolerance": 0.05,  # arms under impedance sag [rad]
        },
        "moveit_controller_manager": "moveit_simple_controller_manager/MoveItSimpleControllerManager",
        "moveit_simple_controller_manager": {
            "controller_names": list(served),
            **{
                name: {
                    "type": "FollowJointTrajectory",
                    "action_ns": "follow_joint_trajectory",
                    "default": True,
                    "joints": joints,
                }
                for name, joints in served.items()
            },
        },
    }


def cartesian_limits(robot: RobotDescription) -> dict[str, Any]:
    """``pilz_cartesian_limits.yaml``: as the setup assistant has them, for an arm of a leg's length of a metre."""
    size = robot.tables.size.leg
    limits = {"max_trans_vel": 1.0, "max_trans_acc": 2.25, "max_trans_dec": -5.0}
    return {
        "cartesian_limits": {name: round(size * value, 3) for name, value in limits.items()} | {"max_rot_vel": 1.57}
    }
