"""A bag of ESCHER's arm and neck moving, simulated, and written by another writer than the recorder's."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from bifrost import Message
from harness.bag_file import type_store, write_bag
from harness.motion_states import motion_state
from valor.common.arrays import FloatArray
from valor.common.messages import GroundTruth, JointSetpoints, Motor, Proprioceptor
from valor.common.topics import GROUND_TRUTH, JOINT_SETPOINTS, MOTION_STATE, MOTOR, PROPRIOCEPTOR, Topic
from valor.robot.description import RobotDescription
from valor.robot.model import Model, robot_spec

GOALS = {"r_shoulder_pitch": -0.8, "r_shoulder_roll": -0.5, "r_elbow_pitch": 0.9, "neck_yaw": -0.5, "neck_pitch": 0.2}
STAND, FREE = 1.0, 5.0  # when the arms are freed, and when they are locked again [s]
END, RATE = 6.0, 100.0


def still(time: float) -> tuple[Any, float]:
    """A pelvis that stays: shift (3,) [m] and turn about the vertical [rad] from where it hangs."""
    return np.zeros(3), 0.0


class HungRobot:
    """A robot hung by its pelvis, its joints servoed; gravity and their own damping act on them.

    Attributes:
        base: (7,) where the pelvis hangs: position [m], quaternion.
        effort: (n,) of the servos, at the last step [N·m].
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._model = Model(robot, robot_spec(robot, "none").compile())
        self._data = mujoco.MjData(self._model.mj)
        self._data.qpos[:] = self._model.nominal_qpos()
        self.base = self._data.qpos[:7].copy()
        self.effort = np.zeros(len(robot.joints))

    def advance(self, period: float, reference: FloatArray) -> None:
        """Go on by a period [s] after a reference (n,) [rad]."""
        robot, model, data = self._robot, self._model, self._data
        for _ in range(round(period / model.mj.opt.timestep)):
            self.effort = robot.servo_stiffness * (reference - data.qpos[model.qpos])
            data.qfrc_applied[model.dof] = self.effort - robot.servo_damping * data.qvel[model.dof]
            mujoco.mj_step(model.mj, data)
            data.qpos[:7], data.qvel[:6] = self.base, 0.0

    @property
    def position(self) -> FloatArray:
        """(n,) [rad]."""
        position: FloatArray = self._data.qpos[self._model.qpos].copy()
        return position

    @property
    def velocity(self) -> FloatArray:
        """(n,) [rad/s]."""
        velocity: FloatArray = self._data.qvel[self._model.dof].copy()
        return velocity

    @property
    def com(self) -> FloatArray:
        """(3,) [m]."""
        com: FloatArray = self._data.subtree_com[0].copy()
        return com


def simulate(
    robot: RobotDescription, pelvis: Callable[[float], tuple[Any, float]] = still
) -> Iterator[tuple[Topic[Any], Message]]:
    """The robot hung by its pelvis, its joints servoed after a reference that reaches out and comes back.

    Measurement, command and reference differ as they would.

    Args:
        robot: whose.
        pelvis: how the estimated pelvis moves, as ``still`` says.
    """
    hung = HungRobot(robot)
    nominal, target = robot.nominal_posture, robot.nominal_posture.copy()
    for joint, goal in GOALS.items():
        target[robot.index[joint]] = goal
    commanded = [robot.index[joint] for group in ("right_arm", "neck") for joint in robot.tables.groups[group]]
    for k in range(int(END * RATE)):
        now = k / RATE
        reach = np.clip(min((now - STAND) / 1.5, (FREE - now) / 1.5), 0.0, 1.0)
        reference = nominal + (0.5 - 0.5 * np.cos(np.pi * reach)) * (target - nominal)
        hung.advance(1.0 / RATE, reference)
        free = STAND <= now < FREE
        yield from _messages(robot, hung, k, reference, free, pelvis(now))
        if free:
            none = np.zeros(len(commanded))
            yield JOINT_SETPOINTS, JointSetpoints(
                time=round(now * 1e9), names=[robot.joints[i] for i in commanded], position=reference[commanded],
                velocity=none, acceleration=none,
            )  # fmt: skip


def _messages(
    robot: RobotDescription, hung: HungRobot, k: int, reference: FloatArray, free: bool, pelvis: tuple[Any, float]
) -> Iterator[tuple[Topic[Any], Message]]:
    """What the k-th period is told in, the arms' set-points excepted."""
    time, base, com = round(k / RATE * 1e9), hung.base, hung.com
    zeros, none, wrench = np.zeros(len(robot.joints)), np.zeros(3), np.zeros(6)
    standing = np.ones(2, dtype=np.uint8)
    yield PROPRIOCEPTOR, Proprioceptor(
        time=time, sequence=k + 1, motor_sequence=k, joint_position=hung.position, joint_velocity=hung.velocity,
        joint_effort=hung.effort, imu_orientation=base[3:], imu_angular_velocity=none, imu_linear_acceleration=none,
        kvh_angular_velocity=np.zeros(0), kvh_linear_acceleration=np.zeros(0),
        left_foot_wrench=wrench, right_foot_wrench=wrench, left_hand_wrench=wrench, right_hand_wrench=wrench,
        battery_voltage=48.0, motor_behavior="stand",
    )  # fmt: skip
    yield MOTOR, Motor(
        time=time, sequence=k + 1, proprioceptor_sequence=k + 1, mode=np.ones(len(zeros), dtype=np.uint8),
        position=reference, velocity=zeros, effort=zeros, stiffness=robot.servo_stiffness,
        damping=robot.servo_damping, behavior="stand", writer=1,
    )  # fmt: skip
    shift, turn = pelvis
    turned = np.empty(4)
    mujoco.mju_mulQuat(turned, np.array((np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2))), base[3:])
    yield MOTION_STATE, motion_state(
        time=time, proprioceptor_sequence=k + 1, behavior="stand_manipulate" if free else "stand",
        locomotion="stand", manipulation="teleop" if free else "slave", attention="look",
        pelvis_position_in_odom=base[:3] + shift, pelvis_orientation_in_odom=turned,
        com_in_odom=com, dcm_in_odom=com, dcm_reference_in_odom=com, cop_in_odom=com[:2],
        contacts=standing, contact_probability=np.ones(2), left_arm="setpoints", right_arm="setpoints",
        joint_setpoint=reference, pelvis_setpoint=wrench, pelvis_in_support=wrench,
        desired_foot_forces=np.zeros(2), qp_status=1,
    )  # fmt: skip
    yield GROUND_TRUTH, GroundTruth(
        time=time, pelvis_position_in_world=base[:3], pelvis_orientation_in_world=base[3:],
        pelvis_linear_velocity_in_world=none, com_in_world=com, contacts=standing, joint_position=hung.position,
        fixture_position=np.zeros(0),
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
    store = type_store("valor_msgs")
    stamp_type = store.types["builtin_interfaces/msg/Time"]
    header_type = store.types["std_msgs/msg/Header"]

    def rows() -> Iterator[tuple[int, str, str, Any]]:
        for i, (topic, message) in enumerate(messages):
            name = f"valor_msgs/msg/{topic.type.__name__}"
            wall = 1_700_000_000_000_000_000 + i * 1_000_000
            header = header_type(stamp=stamp_type(sec=wall // 10**9, nanosec=wall % 10**9), frame_id=topic.owner)
            fields = {field: getattr(message, field) for field in message.__struct_fields__}
            yield wall, f"/bifrost/{topic.name}", name, store.types[name](header=header, bifrost_sequence=i, **fields)

    write_bag(path, store, rows())
