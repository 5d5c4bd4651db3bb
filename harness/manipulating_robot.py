"""A robot in Stand Manipulate in one process: arms and hands led, the hands' truth, weights that hang at them."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import numpy.typing as npt

from bifrost import Received
from harness.robot_in_process import RobotInProcess
from harness.worn_arms import WORN, wear
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.common.messages import HandGoal, JointSetpoints
from valor.motion_manager.handlers.joint_setpoints import JointSetpointsHandler
from valor.motion_manager.handlers.motion import HandGoalHandler
from valor.robot.description import RobotDescription
from valor.robot.posture_move import PostureMove

SHARE = 0.5  # of the joints' speed, at which set-points lead them


class ManipulatingRobot(RobotInProcess):
    """Odom is where the soles stood when the estimate began; with profile ``WORN`` its arms are.

    Attributes:
        robot: what it is.
        sites: of the left and right hand, in the plant's model.
        load: the weight that hangs at each hand [kg].
    """

    def __init__(
        self, robot: RobotDescription, profile: str, seed: int, load: float = 0.0, world: str = "flat"
    ) -> None:
        self.load = 0.0
        super().__init__(robot, profile, seed, world)
        if profile == WORN:
            wear(self.plant, seed)
        self.robot = robot
        tables = robot.tables
        hands = (tables.hands.left, tables.hands.right)
        self.sites = [self.plant.model.site(hand.site) for hand in hands if hand is not None]
        self._bodies = [self.plant.model.body(hand.body) for hand in hands if hand is not None]
        soles = [self.plant.model.site(foot.sole) for foot in (tables.feet.left, tables.feet.right)]
        self.step()
        data = self.plant.data
        middle = np.mean(data.site_xpos[soles], axis=0)
        heading = np.sum(data.site_xmat[soles].reshape(2, 3, 3)[:, :, 0], axis=0)
        angle = math.atan2(heading[1], heading[0])
        c, s = math.cos(angle), math.sin(angle)
        self._odom = middle, np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
        assert not (refused := self.stand_up()), refused
        self.run(1.0)
        assert not self.ask(Behavior.STAND_MANIPULATE)
        self.run(1.5)
        self.load = load

    def step(self) -> None:
        """One control period, a weight hanging at each hand."""
        if self.load:
            data, weight = self.plant.data, np.array((0.0, 0.0, -9.81 * self.load))
            for site, body in zip(self.sites, self._bodies, strict=True):
                data.xfrc_applied[body, :3] = weight
                data.xfrc_applied[body, 3:] = np.cross(data.site_xpos[site] - data.xipos[body], weight)
        super().step()

    def hand(self, side: int) -> tuple[FloatArray, FloatArray]:
        """The true place (3,) [m] and rotation (3, 3) of a hand in odom."""
        data, (origin, turn) = self.plant.data, self._odom
        site = self.sites[side]
        return turn.T @ (data.site_xpos[site] - origin), turn.T @ data.site_xmat[site].reshape(3, 3)

    def send(self, side: int, position: FloatArray, orientation: FloatArray) -> None:
        """A hand's goal in odom; it must be taken."""
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, orientation.ravel())
        message = HandGoal(self.manager.time, side, True, "odom", position, quaternion)
        handler = HandGoalHandler(self.manager.components)
        assert handler.handle(Received(message, 0, 1, "benchmark"), self.manager.time)

    def follow(self, joints: npt.NDArray[np.intp], goal: FloatArray) -> None:
        """Lead joints to a posture by set-points, as an action does, at half of their speed."""
        limits = self.manager.components.reference.limits
        start = self.manager.components.reference.position
        target = start.copy()
        target[joints] = goal
        move = PostureMove(
            start, target, velocity=SHARE * limits.velocity, acceleration=limits.acceleration, began=self.time,
            shortest=1.0,
        )  # fmt: skip
        names = [self.robot.joints[i] for i in joints]
        handler = JointSetpointsHandler(self.manager.components)
        while move.progress(self.time) < 1.0:
            wanted = (each[joints] for each in move.at(self.time))
            message = JointSetpoints(self.manager.time, names, *wanted)
            assert handler.handle(Received(message, 0, 1, "benchmark"), self.manager.time)
            self.step()

    def in_odom(self, place: FloatArray, turn: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A pose of the true pelvis, now: place (3,) [m] and rotation (3, 3)."""
        data, (origin, odom) = self.plant.data, self._odom
        base = self.plant.model.body(self.robot.tables.base)
        pelvis = data.xmat[base].reshape(3, 3)
        return odom.T @ (data.xpos[base] + pelvis @ place - origin), odom.T @ pelvis @ turn
