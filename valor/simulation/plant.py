"""The simulated robot in its world: MuJoCo, with masses and friction that differ from the controller's model."""

import logging
import math

import mujoco
import numpy as np

import bifrost
from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError, ValorError
from valor.common.messages import GroundTruth, PushReply, PushRequest
from valor.common.topics import PUSH
from valor.robot.description import RobotDescription
from valor.robot.model import Model, Shapes, robot_spec
from valor.simulation import worlds
from valor.simulation.actuators import Actuators, Gears

_HARD = 0.9999  # impedance of holding friction, with which a joint creeps a thousandth as fast


class SimulationDivergedError(ValorError):
    """The state of the simulation is not finite."""


def scene(robot: RobotDescription, world: str, seed: int, shapes: Shapes) -> mujoco.MjSpec:
    """Robot and world of a seed, not compiled. Raises ConfigurationError: unknown world, or invalid robot's files."""
    spec, surroundings = robot_spec(robot, shapes, passive=True), worlds.load(world, seed, worlds.size_of(robot))
    surroundings.option = spec.option
    spec.attach(surroundings, frame=spec.worldbody.add_frame(), prefix=worlds.PREFIX)
    return spec


class Plant:
    """Physics of robot and world, at first in the nominal posture; ``model`` has its own masses and friction."""

    def __init__(self, robot: RobotDescription, world: str, profile: str, seed: int, *, spins: bool = False) -> None:
        """``spins``: see ``Actuators``; the angles of such joints are within ±π."""
        if profile not in robot.tables.actuators:
            known = ", ".join(robot.tables.actuators)
            raise ConfigurationError(f"actuators {profile!r}: expected one of robot.yaml's profiles: {known}")
        table = robot.tables.actuators[profile]
        # By default MuJoCo writes warnings to a file in the working directory.
        mujoco.set_mju_user_warning(logging.getLogger("simulation").warning)
        self.model = Model(robot, scene(robot, world, seed, "collision").compile())
        mj = self.model.mj
        self._scale_masses(table.mass_error, np.random.default_rng([seed, 0]))
        gears = Gears.of(robot, table)
        mj.dof_frictionloss[self.model.dof] = gears.friction
        # MuJoCo's friction is soft: a light joint under load creeps by 0.1 rad/s.
        mj.dof_solimp[np.arange(mj.nv)[self.model.dof][gears.sticks], :2] = _HARD
        self.actuators = Actuators(robot, table, mj.opt.timestep, spins)
        if elastic := self.actuators.elastic:  # inertia and friction of its motors are behind the springs
            sprung = np.arange(mj.nv)[self.model.dof][elastic.joints]
            mj.dof_armature[sprung] = mj.dof_frictionloss[sprung] = 0.0
        # Divergence must be an error, not a reset.
        mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        # One robot is one island, and each contact moves few of its joints: a step takes a fifth less time.
        mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
        mj.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
        self.data = mujoco.MjData(mj)
        mujoco.mj_setConst(mj, self.data)
        self.data.qpos[:] = self.model.nominal_qpos()
        mujoco.mj_forward(mj, self.data)
        self._spinning = [int(mj.joint(robot.joints[i]).qposadr[0]) for i in self.actuators.spinning]
        self._fixtures = worlds.joints(mj)
        self._chest = self._pushed_body = self.model.body(robot.tables.chest)
        self._push_steps = 0
        self._qpos, self._qvel, self._applied = self.data.qpos, self.data.qvel, self.data.qfrc_applied

    @property
    def step_time(self) -> float:
        return float(self.model.mj.opt.timestep)

    @property
    def joint_position(self) -> FloatArray:
        """(n,) true joint positions, a copy [rad]."""
        position: FloatArray = self._qpos[self.model.qpos].copy()
        return position

    @property
    def fixture_position(self) -> FloatArray:
        """(m,) positions of the world's joints, a copy [rad]."""
        position: FloatArray = self._qpos[self._fixtures].copy()
        return position

    def step(self, count: int) -> None:
        """Advance by ``count`` physics steps. Raises SimulationDivergedError: the state is not finite."""
        model, data, update = self.model, self.data, self.actuators.update
        for _ in range(count):
            self._applied[model.dof] = update(self._qpos[model.qpos], self._qvel[model.dof])
            mujoco.mj_step(model.mj, data)
            if self._push_steps:
                self._push_steps -= 1
                if not self._push_steps:
                    data.xfrc_applied[self._pushed_body] = 0.0
        for joint in self._spinning:
            self._qpos[joint] = math.remainder(self._qpos[joint], math.tau)
        if not np.isfinite(self._qvel.dot(self._qvel)):
            raise SimulationDivergedError(f"the simulation diverged at {data.time:.3f} s")

    def push(self, impulse: FloatArray, duration: float, body: str = "") -> None:
        """Push a body of the robot, the chest if empty, at its CoM with a constant force, from the next step on.

        ``impulse``: (3,) in world [N·s]; ``duration``: rounded to physics steps, at least one [s].
        """
        self.data.xfrc_applied[self._pushed_body] = 0.0
        self._pushed_body = self.model.body(body) if body else self._chest
        self._push_steps = max(1, round(duration / self.step_time))
        self.data.xfrc_applied[self._pushed_body, :3] = impulse / (self._push_steps * self.step_time)

    def has_body(self, name: str) -> bool:
        """Return whether the robot has a body of that name."""
        number = mujoco.mj_name2id(self.model.mj, mujoco.mjtObj.mjOBJ_BODY, name)
        return bool(number > 0 and self.model.mj.body_rootid[number] == self.model.mj.body_rootid[self._chest])

    @property
    def pushed(self) -> bool:
        return self._push_steps > 0

    def _scale_masses(self, error: float, rng: np.random.Generator) -> None:
        mj = self.model.mj
        base = self.model.body(self.model.robot.tables.base)
        for body in range(mj.nbody):
            if mj.body_rootid[body] == base:
                factor = 1.0 + rng.uniform(-error, error)
                mj.body_mass[body] *= factor
                mj.body_inertia[body] *= factor


AT_ONCE = 4  # largest number of requests per period
DEFAULT_DURATION = 0.1  # of requests with duration 0 [s]
LONGEST = 2.0  # [s]
LARGEST = 500.0  # [N·s]


class PushServer:
    """Server of ``simulation/push``."""

    def __init__(self, node: bifrost.Node, plant: Plant) -> None:
        self._plant = plant
        self._time = 0
        self._server = PUSH.server(node, self._push)

    def serve(self, time: int) -> None:
        """Process pending requests at a robot time [ns]; 0: robot time has not started."""
        self._time = time
        self._server.serve(AT_ONCE)

    def _push(self, request: PushRequest, origin: str) -> PushReply:
        if not (reason := self._fault(request)):
            self._plant.push(request.impulse_in_world, request.duration or DEFAULT_DURATION, request.body)
        return PushReply(accepted=not reason, time=self._time, reason=reason)

    def _fault(self, request: PushRequest) -> str:
        impulse, duration = request.impulse_in_world, request.duration
        if impulse.size != 3:
            return f"impulse_in_world: {impulse.size} numbers, expected 3"
        magnitude = math.sqrt(float(impulse.dot(impulse)))
        if not magnitude <= LARGEST:  # also rejects NaN
            return f"impulse_in_world: {magnitude:g} N·s, expected at most {LARGEST:g}"
        if not 0.0 <= duration <= LONGEST:
            return f"duration: {duration:g} s, expected up to {LONGEST:g}, or 0 for {DEFAULT_DURATION:g}"
        if request.body and not self._plant.has_body(request.body):
            return f"body: {request.body[:64]!r}, expected one of the robot's model"
        if self._plant.pushed:
            return "an earlier push still acts"
        if not self._time:
            return "robot time has not started: no Motor has been received yet"
        return ""


class Truth:
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
