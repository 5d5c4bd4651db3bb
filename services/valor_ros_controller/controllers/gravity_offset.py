"""Offset of the arms' commands against their weight, for arms under PD control (``arm_control: pd``).

A joint that carries τ rests at its set-point minus τ/k. The controller adds τ/k to the commands of others, by
command rectification (thesis 3.5), from the masses of the robot's model, measured joints and the IMU's attitude.
"""

import logging
from collections.abc import Mapping, Sequence
from math import cos, sin
from typing import Self

import numpy as np

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.robot.kinematic_tree import KinematicTree
from valor.valor_ros_controller.controller_manager import Controller, Resources
from valor.valor_ros_controller.controllers.configuration import ControllerConfig
from valor.valor_ros_controller.rejection_log import BoundedLog
from valor.valor_ros_controller.valor_escher_hw_interface import LONGEST_STEP, ValorEscherHWInterface

PERIOD = 0.1  # between two computations [s]
SPEED = 0.2  # of an offset, also when it is switched on or off [rad/s]
LARGEST = 0.3  # offset that is accepted [rad]
GRAVITY = 9.81  # [m/s²]

_log = logging.getLogger("gravity_offset")


class GravityOffset(Controller):
    """Off until a client activates it; ``joints``: (n,) indices of its joints in the hardware interface's vectors."""

    type = "valor_ros_controller/GravityOffset"
    command_interfaces = ("position_offset",)

    def __init__(
        self, name: str, config: ControllerConfig, hw: ValorEscherHWInterface, tree: KinematicTree | None
    ) -> None:
        """``tree``: of the robot; without it, or if its Motion System compensates weights, the controller stays off."""
        robot = hw.robot
        self.name, self._log = name, BoundedLog(_log)
        self.joints = hw.group_indices([group for group in config.groups if robot.tables.group(group)])
        self._stiffness = robot.tables.arm_pd.stiffness(robot.servo_stiffness, robot.servo_damping)[self.joints]
        self._target = np.zeros(len(self.joints))
        self._computed = self._time = 0  # robot time of the last computation, and of the last cycle [ns]
        if tree is None or robot.tables.arm_control != "pd":
            self.obstacle = f"{name}: the Motion System compensates the arms' weight; expected arm_control: pd"
            return
        imu = next(frame for frame in tree.frames if frame.target == robot.tables.imu.site)
        self._imu = imu.orientation
        self._weights = Weights(tree, [robot.joints[joint] for joint in self.joints], robot.index)

    @classmethod
    def make(cls, name: str, config: ControllerConfig, resources: Resources) -> Self:
        return cls(name, config, resources.hw, resources.tree)

    def update(self, hw: ValorEscherHWInterface) -> None:
        """Move the offsets to those of the present posture, to zero while inactive."""
        offset = hw.command_offset[self.joints]
        passed, self._time = (hw.time - self._time) * 1e-9, hw.time
        if not self.active:
            if not offset.any():
                return
            self._target = np.zeros(len(self.joints))
        elif abs(hw.time - self._computed) >= PERIOD * 1e9:
            self._compute(hw)
        step = SPEED * min(max(0.0, passed), LONGEST_STEP)
        hw.command_offset[self.joints] = np.clip(self._target, offset - step, offset + step)

    def _compute(self, hw: ValorEscherHWInterface) -> None:
        self._computed = hw.time
        if hw.measured is None:
            return
        w, x, y, z = hw.measured.imu_orientation.tolist()
        up = np.array(rotation.rotate(self._imu, rotation.vertical((w, x, y, z))))
        target = self._weights.torques(hw.position, up) / self._stiffness
        largest = float(np.abs(target).max())
        if largest <= LARGEST:
            self._target = target
        else:  # also if it is not finite
            self._log.warning(f"{self.name}: offset {largest:g} rad rejected; expected at most {LARGEST:g} rad")


class Weights:
    """Torques that hold the links of k joints against gravity, from the masses of a tree."""

    def __init__(self, tree: KinematicTree, joints: Sequence[str], index: Mapping[str, int]) -> None:
        """``joints``: names, (k,); ``index``: of each joint in vectors of positions."""
        carried: set[str] = set()
        for link in tree.links:  # parents first
            if link.joint in joints or link.parent in carried:
                carried.add(link.name)
        needed = set(carried)
        for link in reversed(tree.links):
            if link.name in needed:
                needed.add(link.parent)
        self._links = [link for link in tree.links if link.name in needed]
        self._base, self._joints, self._index = tree.base, joints, index

    def torques(self, position: FloatArray, up: FloatArray) -> FloatArray:
        """(k,) torques [N·m] at joint positions [rad]; ``up``: (3,) vertical in the base's axes."""
        poses: dict[str, tuple[rotation.Quaternion, FloatArray]] = {self._base: (rotation.IDENTITY, np.zeros(3))}
        hinges: dict[str, tuple[FloatArray, FloatArray]] = {}  # axis, and a point on it
        moments: dict[str, FloatArray] = {}  # of a link with those that it carries: mass [kg], times CoM [kg·m]
        for link in self._links:
            turn, origin = poses[link.parent]
            half = 0.5 * float(position[self._index[link.joint]]) if link.joint else 0.0
            fixed = rotation.multiply(turn, link.orientation)
            x, y, z = link.axis
            turned = rotation.multiply(fixed, (cos(half), sin(half) * x, sin(half) * y, sin(half) * z))
            anchor = origin + rotation.rotate(turn, link.position) + np.array(rotation.rotate(fixed, link.anchor))
            place = anchor - rotation.rotate(turned, link.anchor)
            poses[link.name], hinges[link.joint] = (
                (turned, place),
                (np.array(rotation.rotate(fixed, link.axis)), anchor),
            )
            moments[link.name] = link.mass * np.array((1.0, *(place + rotation.rotate(turned, link.com))))
        found = dict.fromkeys(self._joints, 0.0)
        for link in reversed(self._links):
            mass, *moment = moments[link.name]
            if link.joint in found:
                axis, anchor = hinges[link.joint]
                found[link.joint] = GRAVITY * float(axis @ rotation.cross(moment - mass * anchor, up))
            if link.parent in moments:
                moments[link.parent] += moments[link.name]
        return np.array(list(found.values()))
