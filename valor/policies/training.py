"""Export of a robot to mjlab, which trains walking policies: a package of its model and a velocity task.

A servo's gains are those of robot.yaml, reduced where an error of 1 rad would ask for more than the effort limit: a
policy moves its targets as far as it needs torque. An action of 1 asks for a quarter of that limit.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.resources import example_file
from valor.robot.description import RobotDescription
from valor.robot.model import Model, compiled, robot_spec, weld_others
from valor.robot.tables import SIDES

PERIOD = 0.02  # of acts, about [s]
_ERROR = 1.0  # of a joint, from which its servo gives the effort limit, at least [rad]
_SHARE = 0.25  # of the effort limit, for an action of 1
_DEVIATION = {"torso": 0.1, "left_arm": 0.15, "right_arm": 0.15}  # from the nominal posture, expected of a walk [rad]
_SWINGING, _OTHER = 0.35, 0.15  # likewise of a leg's joints that swing it forward, and of the others [rad]
_PROJECT = """\
[project]
name = "{package}"
version = "1"
dependencies = ["mjlab>=1.6,<2"]

[project.entry-points."mjlab.tasks"]
{package} = "{package}"

[build-system]
requires = ["setuptools>=77"]
build-backend = "setuptools.build_meta"

[tool.setuptools]
packages = ["{package}"]
package-data = {{ {package} = ["**"] }}
"""


def export(robot: RobotDescription, folder: Path) -> str:
    """Write the package to a new folder; returns the task's name in mjlab. Raises ConfigurationError."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigurationError(f"{folder}: exists; expected a new folder")
    spec, soles = _spec(robot)
    model = Model(robot, compiled(robot, spec))
    package = re.sub(r"\W", "_", f"{robot.name}_mjlab").lower()
    inside = folder / package
    try:
        inside.mkdir(parents=True)
        for mesh in spec.meshes:
            copy = inside / "meshes" / mesh.file
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes((robot.model_file.parent / spec.meshdir / mesh.file).read_bytes())
        spec.meshdir = "meshes"
        (inside / "robot.xml").write_text(spec.to_xml())
        (inside / "robot.json").write_text(json.dumps(facts(robot, model) | {"sole_geoms": soles}, indent=1))
        (inside / "__init__.py").write_text(example_file("mjlab_task.py").read_text())
        (folder / "pyproject.toml").write_text(_PROJECT.format(package=package))
    except OSError as error:
        raise ConfigurationError(f"{error.filename}: {error.strerror}; expected a folder to write to") from None
    return f"Valor-Velocity-{robot.name}"


def gains(robot: RobotDescription) -> tuple[FloatArray, FloatArray]:
    """Return stiffness (n,) [N·m/rad] and damping (n,) [N·m·s/rad] of the servos under a policy."""
    share = np.minimum(1.0, robot.effort_limit / (_ERROR * robot.servo_stiffness))
    return share * robot.servo_stiffness, np.sqrt(share) * robot.servo_damping  # the same damping ratio


def facts(robot: RobotDescription, model: Model) -> dict[str, Any]:
    """Return what the task knows of a robot beside its model; joints in the model's order."""
    tables, walking = robot.tables, robot.tables.walking
    tick, fastest = robot.control_period, walking.max_forward_speed
    stiffness, _ = gains(robot)
    joints = _in_order(model)
    return {
        "name": robot.name,
        "base": tables.base,
        "chest": tables.chest,
        "feet": [getattr(tables.feet, side).body for side in SIDES],
        "soles": [getattr(tables.feet, side).sole for side in SIDES],
        "height": tables.nominal_base_height,
        "swing_height": walking.plan_swing_height,
        "period": round(max(1, round(PERIOD / tick)) * tick, 9),
        "command_ranges": {"vx": [-fastest, fastest], "vy": [-0.5 * fastest, 0.5 * fastest], "wz": [-1.0, 1.0]},
        "default_position": {name: float(robot.nominal_posture[i]) for name, i in joints.items()},
        "action_scale": {name: float(_SHARE * robot.effort_limit[i] / stiffness[i]) for name, i in joints.items()},
        "pose_deviation": _deviations(robot, model),
    }


def _in_order(model: Model) -> dict[str, int]:
    """Return the joints of the model, as it orders them, with their places in the robot's vectors."""
    names = [model.mj.joint(i).name for i in range(1, model.mj.njnt)]
    return {name: model.robot.index[name] for name in names}


def _spec(robot: RobotDescription) -> tuple[mujoco.MjSpec, list[str]]:
    """Return the model of the joints that balance, with servos and mjlab's sensors, and names of the soles' geoms."""
    spec = robot_spec(robot, "collision")
    weld_others(spec, robot)
    for each in (*spec.keys, *spec.sensors, *spec.actuators):
        spec.delete(each)
    soles = list[str]()
    for side in SIDES:
        for geom in spec.body(getattr(robot.tables.feet, side).body).find_all("geom"):
            geom.name, geom.priority = f"{side}_sole_{len(soles)}", 1  # its friction counts, not the ground's
            soles.append(geom.name)
    stiffness, damping = gains(robot)
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            i, name = robot.index[joint.name], joint.name
            servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=stiffness[i], kv=damping[i])
            servo.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            servo.forcerange = (-robot.effort_limit[i], robot.effort_limit[i])
    spec.body(robot.tables.base).add_site(name="base_frame")  # velocities are those of the base's origin
    site, kind = mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtSensor
    spec.add_sensor(name="imu_lin_vel", type=kind.mjSENS_VELOCIMETER, objtype=site, objname="base_frame")
    spec.add_sensor(name="imu_ang_vel", type=kind.mjSENS_GYRO, objtype=site, objname="base_frame")
    body = mujoco.mjtObj.mjOBJ_BODY
    spec.add_sensor(name="root_angmom", type=kind.mjSENS_SUBTREEANGMOM, objtype=body, objname=robot.tables.base)
    spec.option = mujoco.MjSpec().option  # the task has its own
    return spec, soles


def _deviations(robot: RobotDescription, model: Model) -> Mapping[str, float]:
    """Return joint → expected deviation from the nominal posture [rad]."""
    data = mujoco.MjData(model.mj)
    data.qpos[:] = model.nominal_qpos()
    mujoco.mj_kinematics(model.mj, data)
    found = {name: width for group, width in _DEVIATION.items() for name in robot.tables.group(group)}
    sideways = {name: abs(data.joint(name).xaxis[1]) for name in _in_order(model)}
    return {name: found.get(name, _SWINGING if sideways[name] > np.sqrt(0.5) else _OTHER) for name in sideways}
