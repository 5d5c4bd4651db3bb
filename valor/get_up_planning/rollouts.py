"""Simulation of many falls and motions at once; every joint is on its servo, as when Get Up executes key poses."""

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco import rollout

from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.robot.checks.stance import Stance
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import Balance, Posture, lying, posture_move
from valor.robot.model import Model
from valor.robot.posture_move import PostureMove
from valor.robot.size import ESCHER
from valor.robot.sole_balance import SoleBalance
from valor.robot.tables import SIDES
from valor.simulation.actuators import Gears
from valor.simulation.plant import scene

STEP = 0.004  # of the physics; damping is implicit [s]
THREADS = 2
LYING = 3.0  # time of a fall [s]
PROFILE = "hardware"  # of actuators, if robot.yaml has it: friction and errors of masses
PERIODS = 3  # of the physics in one of the balance
GAIN, LIMIT = 2.0, 0.3  # of the balance with ESCHER's legs [rad/m]; angle [rad]
MARGIN = 2.0  # of the masses' errors
VARIED = (0.75, 1.25)  # factors of friction and of servos' damping
LIMP = 0.02  # damping of a limp joint, relative to its servo's
HEADING = {Posture.FACE: 0.0, Posture.LEFT: 0.5, Posture.BACK: 1.0, Posture.RIGHT: 1.5}  # of a fall [half turns]
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


@dataclass(frozen=True, slots=True)
class Target:
    """Key pose: joint positions (n,) [rad], least duration of the motion to it and hold afterwards [s]."""

    name: str
    goal: FloatArray
    duration: float
    hold: float = 0.0
    balanced: bool = False  # on the soles, where Get Up balances


@dataclass(frozen=True, slots=True)
class Fallen:
    """A robot of its own masses that lies on the floor, limp."""

    mj: mujoco.MjModel
    state: FloatArray
    posture: FloatArray  # (n,) set-points of the joints [rad]
    way: Posture | None  # None: it does not lie


class Rollouts:
    """A robot on flat ground."""

    def __init__(self, robot: RobotDescription) -> None:
        """Raises ConfigurationError: the model is invalid."""
        spec = scene(robot, "flat", 0, "collision")
        spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        for name, stiffness, damping, effort in zip(
            robot.joints, robot.servo_stiffness, robot.servo_damping, robot.effort_limit, strict=True
        ):
            servo = spec.add_actuator(name=f"servo_{name}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
            servo.gainprm[0], servo.biasprm[1:3] = stiffness, (-stiffness, -damping)
            servo.forcelimited, servo.forcerange = True, (-effort, effort)
        self.robot, self.model = robot, Model(robot, spec.compile())
        mj = self.model.mj
        profiles = robot.tables.actuators
        table = profiles.get(PROFILE) or next(iter(profiles.values()))
        mj.dof_frictionloss[self.model.dof] = Gears.of(robot, table).friction
        mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
        self._mass_error = MARGIN * table.mass_error
        self._limits = CommandedLimits.of_joints(robot)
        self._lead = robot.servo_damping / robot.servo_stiffness  # [s]
        self.stance = Stance(robot)
        ankles = [self.stance.pitch_joints(side)[-1] for side in SIDES]
        self.balance = Balance(joints=ankles, gain=round(GAIN * ESCHER.leg / robot.tables.size.leg, 2), limit=LIMIT)
        self._kinematics = mujoco.MjData(mj)
        self._pool = rollout.Rollout(nthread=THREADS)
        self._data = [mujoco.MjData(mj) for _ in range(THREADS)]

    def fallen(self, seeds: Iterable[int]) -> list[Fallen]:
        """Return robots that fell towards each side, one of each seed."""
        models, states, mj = [], [], self.model.mj
        for seed in seeds:
            for way in HEADING:
                rng, own = np.random.default_rng(seed), copy.copy(mj)
                factor = 1.0 + rng.uniform(-self._mass_error, self._mass_error, mj.nbody)
                own.body_mass[:] *= factor
                own.body_inertia[:] *= factor[:, None]
                data = mujoco.MjData(own)
                mujoco.mj_setConst(own, data)
                topple(self.model, data, way, rng)
                states.append(np.empty(mujoco.mj_stateSize(mj, _STATE)))
                mujoco.mj_getState(own, data, states[-1], _STATE)
                models.append(own)
        limp = [copy.copy(own) for own in models]
        for own in limp:
            own.actuator_gainprm[:, 0] = own.actuator_biasprm[:, 1] = 0.0
            own.actuator_biasprm[:, 2] *= LIMP
        out = self._simulate(limp, np.array(states), np.zeros((len(limp), round(LYING / STEP), mj.nu)))[:, -1]
        return [
            Fallen(own, state, self.joints(state), lying(self.upwards(state)))
            for own, state in zip(models, out, strict=True)
        ]

    def varied(self, falls: Iterable[Fallen]) -> list[Fallen]:
        """Return falls with other friction of ground and joints and other damping of servos."""
        found = list[Fallen]()
        for seed, fall in enumerate(falls):
            (ground, joints, damping), own = np.random.default_rng(seed).uniform(*VARIED, 3), copy.copy(fall.mj)
            own.geom_friction[:] *= ground
            own.dof_frictionloss[:] *= joints
            own.actuator_biasprm[:, 2] *= damping
            found.append(replace(fall, mj=own))
        return found

    def play(self, motions: Sequence[tuple[Fallen, Sequence[Target]]]) -> list[list[FloatArray]]:
        """Return the states after each key pose's hold, for each motion; it balances from its first such pose on."""
        commands, ends, open_loop = list[FloatArray](), list[list[int]](), list[int]()
        for fallen, targets in motions:
            start, parts, end = fallen.posture, list[FloatArray](), [0]
            for target in targets:
                parts += self._command(start, target)
                start = target.goal
                end.append(sum(map(len, parts)))
            commands.append(np.concatenate(parts))
            ends.append(end[1:])
            open_loop.append(min((i for i, each in zip(end, targets, strict=False) if each.balanced), default=end[-1]))
        rest = max(len(each) - first for each, first in zip(commands, open_loop, strict=True))
        longest = max(open_loop) + rest
        padded = np.stack([np.pad(each, ((0, longest - len(each)), (0, 0)), "edge") for each in commands])
        models, states = [one.mj for one, _ in motions], np.array([one.state for one, _ in motions])
        reached = np.concatenate([states[:, None], self._simulate(models, states, padded[:, : max(open_loop)])], axis=1)
        started = np.array([each[first] for each, first in zip(reached, open_loop, strict=True)])
        remaining = np.stack([each[first : first + rest] for each, first in zip(padded, open_loop, strict=True)])
        balanced = self._balance(models, started, remaining)
        return [
            [(before[i] if i <= first else later[i - first]) for i in end]
            for before, later, first, end in zip(reached, balanced, open_loop, ends, strict=True)
        ]

    def _balance(self, models: list[mujoco.MjModel], states: FloatArray, commands: FloatArray) -> FloatArray:
        """Return the states (k, t + 1, ·), from the first on, under commands (k, t, n) and the balance of Get Up."""
        out, balances = [states[:, None]], [SoleBalance(self.robot, self.balance) for _ in models]
        for i in range(0, commands.shape[1], PERIODS):
            chunk = commands[:, i : i + PERIODS].copy()
            for k, (state, balance) in enumerate(zip(states, balances, strict=True)):
                position, (com, forward, _, _) = chunk[k, 0].copy(), self.over_soles(state)
                balance.lean(position, com, forward, i * STEP)
                chunk[k] += position - chunk[k, 0]
            out.append(self._simulate(models, states, chunk))
            states = out[-1][:, -1]
        return np.concatenate(out, axis=1)

    def over_soles(self, state: FloatArray) -> tuple[FloatArray, FloatArray, float, float]:
        """Return the CoM (3,) from between the soles' frames [m], the sum (2,) of their axes, tilt and height.

        Of the soles: 1 less the cosine of their tilt, and the height of their middles above the ground [m], both means.
        """
        model, data = self.model, self._kinematics
        data.qpos[:] = state[1 : 1 + model.mj.nq]
        mujoco.mj_kinematics(model.mj, data)
        mujoco.mj_comPos(model.mj, data)
        com, forward, tilt, height = data.subtree_com[model.body(self.robot.tables.base)].copy(), np.zeros(2), 0.0, 0.0
        for side in SIDES:
            foot, site = self.stance.foot(side), data.site(self.stance.foot(side).sole)
            com -= 0.5 * site.xpos
            forward += site.xmat[[0, 3]]
            tilt += 0.5 * (1.0 - site.xmat[8])
            height += 0.5 * abs(site.xpos[2] + 0.5 * (foot.heel + foot.toe) * site.xmat[6])
        return com, forward, tilt, height

    def duration(self, start: FloatArray, targets: Sequence[Target]) -> float:
        """Return the time of the motions between key poses from (n,) joint positions, without holds [s]."""
        return sum(
            self.move(before, target).duration
            for before, target in zip([start, *(target.goal for target in targets)], targets, strict=False)
        )

    def move(self, start: FloatArray, target: Target) -> PostureMove:
        """Return the motion to a key pose from (n,) joint positions."""
        return posture_move(self._limits, start, target.goal, target.duration)

    def joints(self, state: FloatArray) -> FloatArray:
        """Return the joint positions (n,) [rad] in a state."""
        positions: FloatArray = state[1 : 1 + self.model.mj.nq][self.model.qpos]
        return positions

    def upwards(self, state: FloatArray) -> rotation.Vector:
        """Return the vertical in the pelvis' axes."""
        return rotation.vertical(rotation.quaternion(state[4:8]))

    def speed(self, state: FloatArray) -> float:
        """Return the largest component of the pelvis' velocity [m/s, rad/s]."""
        return float(np.abs(state[1 + self.model.mj.nq :][:6]).max())

    def _command(self, start: FloatArray, target: Target) -> Iterable[FloatArray]:
        move = self.move(start, target)
        times = STEP * np.arange(1, max(1, round(move.duration / STEP)) + 1)
        moved = [position + self._lead * velocity for position, velocity, _ in map(move.at, times)]
        return np.array(moved), np.tile(target.goal, (round(target.hold / STEP), 1))

    def _simulate(self, models: list[mujoco.MjModel], states: FloatArray, commands: FloatArray) -> FloatArray:
        if not commands.shape[1]:
            return states[:, None][:, :0]
        out, _ = self._pool.rollout(models, self._data, initial_state=states, control=commands)
        return np.asarray(out)


def topple(model: Model, data: mujoco.MjData, way: Posture, rng: np.random.Generator) -> None:
    """Tilt a robot towards a side, with any posture of the arms, much as it falls when pushed."""
    robot, heading = model.robot, HEADING[way] * np.pi + rng.uniform(-0.5, 0.5)
    tilt = rng.uniform(0.6, 1.2)  # [rad]
    data.qpos[:] = model.nominal_qpos()
    data.qpos[2] += 0.1
    data.qpos[3:7] = (np.cos(tilt / 2), *(np.sin(tilt / 2) * np.array([-np.sin(heading), np.cos(heading), 0.0])))
    arms = [robot.index[name] for side in SIDES for name in robot.tables.group(f"{side}_arm")]
    share, spread = np.full(len(robot.joints), 0.1), rng.uniform(robot.lower.clip(-2.0), robot.upper.clip(max=2.0))
    share[arms] = rng.uniform(0.0, 0.9)
    posture = robot.nominal_posture + share * (spread - robot.nominal_posture)
    data.qpos[model.qpos] = posture.clip(robot.lower, robot.upper)
    data.qvel[:] = 0.0
    data.qvel[3:6] = rng.normal(0.0, 0.5, 3)
