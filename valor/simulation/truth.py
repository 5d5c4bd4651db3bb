"""Publishes the simulator's truth, for experiments and pictures: no controller may read it."""

from __future__ import annotations

import mujoco
import numpy as np

import bifrost
from valor.common.messages import GroundTruth
from valor.robot.description import RobotDescription
from valor.simulation.plant import Plant


class Truth:
    """Reads GroundTruth from the plant."""

    RATE = 100.0  # of robot time [Hz]

    def __init__(self, robot: RobotDescription, plant: Plant, publisher: bifrost.Publisher[GroundTruth]) -> None:
        self._plant = plant
        self._publisher = publisher
        mj = plant.model.mj
        self._base = plant.model.body(robot.tables.base)
        feet = (robot.tables.feet.left, robot.tables.feet.right)
        self._feet = [plant.model.body(foot.body) for foot in feet]
        self._geom_body = mj.geom_bodyid.copy()

    def publish(self, time: int) -> None:
        """Publish the truth at that robot time [ns]."""
        plant = self._plant
        mj, data = plant.model.mj, plant.data
        contacts = np.array([self._touches(foot) for foot in self._feet], dtype=np.uint8)
        # Position-dependent quantities in MuJoCo's data lag the state by one step.
        mujoco.mj_kinematics(mj, data)
        mujoco.mj_comPos(mj, data)
        self._publisher.publish(
            GroundTruth(
                time=time,
                pelvis_position_in_world=data.qpos[:3].copy(),
                pelvis_orientation_in_world=data.qpos[3:7].copy(),
                pelvis_linear_velocity_in_world=data.qvel[:3].copy(),
                com_in_world=data.subtree_com[self._base].copy(),
                joint_position=plant.joint_position,
                contacts=contacts,
                fixture_position=plant.fixture_position,
            )
        )

    def _touches(self, body: int) -> bool:
        contact = self._plant.data.contact
        return bool((self._geom_body[contact.geom] == body).any())
