"""Fixtures of the Whole-Body Controller's tests: ESCHER, its reduced model, and random states."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest

from harness.closed_loop import load_robot
from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.control.kinematics import Kinematics
from valor.robot.description import RobotDescription
from valor.robot.model import Model, controller_model
from valor.whole_body.task_dynamics import TaskDynamics
from valor.whole_body.tasks import motions


@pytest.fixture(scope="session")
def robot() -> RobotDescription:
    return load_robot()


@pytest.fixture(scope="session")
def model(robot: RobotDescription) -> Model:
    return controller_model(robot)


@dataclass
class RandomState:
    """A state of the model, and MuJoCo's own data at it (every quantity, by ``mj_forward``)."""

    qpos: FloatArray
    qvel: FloatArray
    data: mujoco.MjData

    def evaluate(self, model: Model) -> TaskDynamics:
        """The dynamics at this state, which never sees where the pelvis is nor its linear velocity."""
        kinematics = Kinematics(model)
        dynamics = TaskDynamics(kinematics, motions(model))
        kinematics.update(
            rotation.quaternion(self.qpos[3:7]), self.qvel[3:6].copy(), self.qpos[7:].copy(), self.qvel[6:].copy()
        )
        dynamics.evaluate()
        return dynamics


def random_states(model: Model, count: int, seed: int) -> Iterator[RandomState]:
    """Random postures within the joints' limits, places, tilts and velocities."""
    rng = np.random.default_rng(seed)
    places = np.arange(len(model.robot.joints))[model.joint_indices]
    lower, upper = model.robot.lower[places], model.robot.upper[places]
    for _ in range(count):
        data = mujoco.MjData(model.mj)
        data.qpos[:3] = rng.uniform(-2.0, 2.0, 3)
        data.qpos[3:7] = rotation.quaternion(rng.normal(size=4))
        data.qpos[model.qpos] = rng.uniform(lower, upper)
        data.qvel[:] = rng.normal(size=model.mj.nv)
        mujoco.mj_forward(model.mj, data)
        yield RandomState(data.qpos.copy(), data.qvel.copy(), data)
