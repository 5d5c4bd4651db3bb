"""The simulated robot in its world: MuJoCo, with masses and friction that the controller does not know."""

from __future__ import annotations

import logging

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError, ValorError
from valor.robot.description import RobotDescription
from valor.robot.model import Model, Shapes, robot_spec
from valor.simulation import worlds
from valor.simulation.actuators import Actuators
from valor.simulation.gears import Gears

_HARD = 0.9999  # impedance of friction that holds: such a joint creeps a thousandth as fast


class SimulationDivergedError(ValorError):
    """The physics gave numbers that are not finite."""


def scene(robot: RobotDescription, world: str, seed: int, shapes: Shapes) -> mujoco.MjSpec:
    """A robot in a world made from a seed, not compiled.

    Raises:
        ConfigurationError: no such world, or the robot's files are wrong.
    """
    spec, surroundings = robot_spec(robot, shapes, passive=True), worlds.load(world, seed, worlds.size_of(robot))
    surroundings.option = spec.option
    spec.attach(surroundings, frame=spec.worldbody.add_frame(), prefix=worlds.PREFIX)
    return spec


class Plant:
    """The physics: stands in the nominal posture until stepped.

    Attributes:
        model: addresses and the MuJoCo model with the plant's own masses and friction.
        data: MuJoCo's state.
        actuators: the motors.
    """

    def __init__(self, robot: RobotDescription, world: str, profile: str, seed: int) -> None:
        if profile not in robot.tables.actuators:
            known = ", ".join(robot.tables.actuators)
            raise ConfigurationError(f"actuators {profile!r}: expected one of robot.yaml's profiles: {known}")
        table = robot.tables.actuators[profile]
        # By itself MuJoCo writes its warnings to a file in the working directory.
        mujoco.set_mju_user_warning(logging.getLogger("simulation").warning)
        self.model = Model(robot, scene(robot, world, seed, "collision").compile())
        mj = self.model.mj
        self._scale_masses(table.mass_error, np.random.default_rng([seed, 0]))
        gears = Gears.of(robot, table)
        mj.dof_frictionloss[self.model.dof] = gears.friction
        # MuJoCo's friction is soft: a light joint under load creeps by a tenth of a radian a second.
        mj.dof_solimp[np.arange(mj.nv)[self.model.dof][gears.sticks], :2] = _HARD
        # A plant that diverges must be seen, not put back on its feet.
        mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        # One robot is one island, and each contact moves few of its joints: a fifth off the time of a step.
        mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
        mj.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
        self.data = mujoco.MjData(mj)
        mujoco.mj_setConst(mj, self.data)
        self.data.qpos[:] = self.model.nominal_qpos()
        mujoco.mj_forward(mj, self.data)
        self.actuators = Actuators(robot, table, mj.opt.timestep)
        self._fixtures = worlds.joints(mj)
        self._chest = self._pushed_body = self.model.body(robot.tables.chest)
        self._push_steps = 0
        self._qpos, self._qvel, self._applied = self.data.qpos, self.data.qvel, self.data.qfrc_applied

    @property
    def step_time(self) -> float:
        """Of one physics step [s]."""
        return float(self.model.mj.opt.timestep)

    @property
    def joint_position(self) -> FloatArray:
        """(n,) the true ones, a copy [rad]."""
        position: FloatArray = self._qpos[self.model.qpos].copy()
        return position

    @property
    def fixture_position(self) -> FloatArray:
        """(m,) of the world's joints, a copy [rad]."""
        position: FloatArray = self._qpos[self._fixtures].copy()
        return position

    def step(self, count: int) -> None:
        """Advance by ``count`` physics steps.

        Raises:
            SimulationDivergedError: the state is not finite any more.
        """
        model, data, update = self.model, self.data, self.actuators.update
        for _ in range(count):
            self._applied[model.dof] = update(self._qpos[model.qpos], self._qvel[model.dof])
            mujoco.mj_step(model.mj, data)
            if self._push_steps:
                self._push_steps -= 1
                if not self._push_steps:
                    data.xfrc_applied[self._pushed_body] = 0.0
        if not np.isfinite(self._qvel.dot(self._qvel)):
            raise SimulationDivergedError(f"the simulation diverged at {data.time:.3f} s")

    def push(self, impulse: FloatArray, duration: float, body: str = "") -> None:
        """Push a body at its CoM with a constant force, from the next step on.

        Args:
            impulse: (3,) in world [N·s].
            duration: of the push, rounded to physics steps, at least one [s].
            body: of the robot's model; empty: the chest.
        """
        self.data.xfrc_applied[self._pushed_body] = 0.0
        self._pushed_body = self.model.body(body) if body else self._chest
        self._push_steps = max(1, round(duration / self.step_time))
        self.data.xfrc_applied[self._pushed_body, :3] = impulse / (self._push_steps * self.step_time)

    def has_body(self, name: str) -> bool:
        """Whether the robot has a body of that name; those of the world do not count."""
        number = mujoco.mj_name2id(self.model.mj, mujoco.mjtObj.mjOBJ_BODY, name)
        return bool(number > 0 and self.model.mj.body_rootid[number] == self.model.mj.body_rootid[self._chest])

    @property
    def pushed(self) -> bool:
        """Whether a push acts now."""
        return self._push_steps > 0

    def _scale_masses(self, error: float, rng: np.random.Generator) -> None:
        """Each body of the robot is lighter or heavier than the controller believes, its inertia with it."""
        mj = self.model.mj
        base = self.model.body(self.model.robot.tables.base)
        for body in range(mj.nbody):
            if mj.body_rootid[body] == base:
                factor = 1.0 + rng.uniform(-error, error)
                mj.body_mass[body] *= factor
                mj.body_inertia[body] *= factor
