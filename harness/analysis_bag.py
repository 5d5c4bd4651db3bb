"""A bag of ESCHER's arm and neck moving, simulated, and written by another writer than the recorder's."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bifrost import Message
from valor.common.messages import GroundTruth, JointSetpoints, MotionState, Motor, Proprioceptor
from valor.common.topics import GROUND_TRUTH, JOINT_SETPOINTS, MOTION_STATE, MOTOR, PROPRIOCEPTOR, Topic
from valor.robot.description import RobotDescription
from valor.robot.model import Model, robot_spec

DEFINITIONS = Path(sys.prefix) / "share" / "valor_msgs" / "msg"
GOALS = {"r_shoulder_pitch": -0.8, "r_shoulder_roll": -0.5, "r_elbow_pitch": 0.9, "neck_yaw": -0.5, "neck_pitch": 0.2}
STAND, FREE = 1.0, 5.0  # when the arms are freed, and when they are locked again [s]
END, RATE = 6.0, 100.0


def still(time: float) -> tuple[Any, float]:
    """A pelvis that stays: shift (3,) [m] and turn about the vertical [rad] from where it hangs."""
    return np.zeros(3), 0.0


def simulate(
    robot: RobotDescription, pelvis: Callable[[float], tuple[Any, float]] = still
) -> Iterator[tuple[Topic[Any], Message]]:
    """The robot hung by its pelvis, its joints servoed after a reference that reaches out and comes back.

    The plant has gravity and the joints' own damping, so measurement, command and reference differ as they would.

    Args:
        robot: whose.
        pelvis: how the estimated pelvis moves, as ``still`` says.
    """
    spec = robot_spec(robot, "none")
    model = Model(robot, spec.compile())
    data = mujoco.MjData(model.mj)
    data.qpos[:] = model.nominal_qpos()
    base = data.qpos[:7].copy()
    nominal, target = robot.nominal_posture, robot.nominal_posture.copy()
    for joint, goal in GOALS.items():
        target[robot.index[joint]] = goal
    n, period = len(robot.joints), 1.0 / RATE
    commanded = [robot.index[joint] for group in ("right_arm", "neck") for joint in robot.tables.groups[group]]
    zeros = np.zeros(n)
    for k in range(int(END * RATE)):
        now = k * period
        reach = np.clip(min((now - STAND) / 1.5, (FREE - now) / 1.5), 0.0, 1.0)
        reach = 0.5 - 0.5 * np.cos(np.pi * reach)
        reference = nominal + reach * (target - nominal)
        for _ in range(round(period / model.mj.opt.timestep)):
            effort = robot.servo_stiffness * (reference - data.qpos[model.qpos])
            data.qfrc_applied[model.dof] = effort - robot.servo_damping * data.qvel[model.dof]
            mujoco.mj_step(model.mj, data)
            data.qpos[:7], data.qvel[:6] = base, 0.0
        time = round(now * 1e9)
        free = STAND <= now < FREE
        yield PROPRIOCEPTOR, Proprioceptor(
            time=time, sequence=k + 1, motor_sequence=k, joint_position=data.qpos[model.qpos].copy(),
            joint_velocity=data.qvel[model.dof].copy(), joint_effort=effort, imu_orientation=base[3:].copy(),
            imu_angular_velocity=np.zeros(3), imu_linear_acceleration=np.zeros(3), left_foot_wrench=np.zeros(6),
            right_foot_wrench=np.zeros(6), left_hand_wrench=np.zeros(6), right_hand_wrench=np.zeros(6),
            battery_voltage=48.0, motor_behavior="stand",
        )  # fmt: skip
        yield MOTOR, Motor(
            time=time, sequence=k + 1, proprioceptor_sequence=k + 1, mode=np.ones(n, dtype=np.uint8),
            position=reference, velocity=zeros, effort=zeros, stiffness=robot.servo_stiffness,
            damping=robot.servo_damping, behavior="stand", writer=1,
        )  # fmt: skip
        com = data.subtree_com[0].copy()
        shift, turn = pelvis(now)
        turned, about = np.empty(4), np.array((np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)))
        mujoco.mju_mulQuat(turned, about, base[3:])
        yield MOTION_STATE, MotionState(
            time=time, proprioceptor_sequence=k + 1, behavior="stand_manipulate" if free else "stand",
            locomotion="stand", manipulation="teleop" if free else "slave", attention="look", reason="",
            pelvis_position_in_odom=base[:3] + shift, pelvis_orientation_in_odom=turned,
            pelvis_linear_velocity_in_odom=np.zeros(3), pelvis_angular_velocity_in_pelvis=np.zeros(3),
            com_in_odom=com, dcm_in_odom=com, dcm_reference_in_odom=com, cop_in_odom=com[:2].copy(),
            contacts=np.ones(2, dtype=np.uint8), contact_probability=np.ones(2),
            pelvis_position_variance=np.zeros(3), pelvis_orientation_variance=np.zeros(3),
            pelvis_linear_velocity_variance=np.zeros(3), hand_contacts=np.zeros(2, dtype=np.uint8),
            left_arm="setpoints", right_arm="setpoints", joint_setpoint=reference, pelvis_setpoint=np.zeros(6),
            pelvis_in_support=np.zeros(6), desired_foot_forces=np.zeros(2),
            qp_status=1, qp_failures=0, torque_saturations=0, motor_time=0.0, tick_time=0.0,
        )  # fmt: skip
        if free:
            yield JOINT_SETPOINTS, JointSetpoints(
                time=time, names=[robot.joints[i] for i in commanded], position=reference[commanded],
                velocity=np.zeros(len(commanded)), acceleration=np.zeros(len(commanded)),
            )  # fmt: skip
        yield GROUND_TRUTH, GroundTruth(
            time=time, pelvis_position_in_world=base[:3].copy(), pelvis_orientation_in_world=base[3:].copy(),
            pelvis_linear_velocity_in_world=np.zeros(3), com_in_world=com, contacts=np.ones(2, dtype=np.uint8),
            joint_position=data.qpos[model.qpos].copy(),
        )  # fmt: skip


def write(
    path: Path,
    robot: RobotDescription,
    without: Topic[Any] | None = None,
    pelvis: Callable[[float], tuple[Any, float]] = still,
) -> None:
    """Simulate and write ``path``, without a topic if one is named; the pelvis as in ``simulate``."""
    write_messages(path, ((topic, message) for topic, message in simulate(robot, pelvis) if topic is not without))


def write_messages(path: Path, messages: Iterable[tuple[Topic[Any], Message]]) -> None:
    """Write messages as the recorder names and types them, a millisecond of wall clock apart."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in sorted(DEFINITIONS.glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(), f"valor_msgs/msg/{file.stem}"))
    folder = path.with_suffix(".folder")
    connections: dict[str, Any] = {}
    stamp_type = store.types["builtin_interfaces/msg/Time"]
    header_type = store.types["std_msgs/msg/Header"]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for i, (topic, message) in enumerate(messages):
            name = f"valor_msgs/msg/{topic.type.__name__}"
            if topic.name not in connections:
                connections[topic.name] = writer.add_connection(f"/bifrost/{topic.name}", name, typestore=store)
            wall = 1_700_000_000_000_000_000 + i * 1_000_000
            header = header_type(stamp=stamp_type(sec=wall // 10**9, nanosec=wall % 10**9), frame_id=topic.owner)
            fields = {field: getattr(message, field) for field in message.__struct_fields__}
            twin = store.types[name](header=header, bifrost_sequence=i, **fields)
            writer.write(connections[topic.name], wall, store.serialize_cdr(twin, name))
    shutil.move(str(next(folder.glob("*.mcap"))), path)
    shutil.rmtree(folder)
