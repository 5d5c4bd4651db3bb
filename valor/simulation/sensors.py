"""Simulated encoders, IMUs and force/torque sensors, with noise from one seed."""

import math

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.messages import Proprioceptor
from valor.devices.kvh import BIASES, DENSITIES
from valor.robot.batteries import Batteries
from valor.robot.description import RobotDescription
from valor.robot.foot_wrenches import completion
from valor.robot.tables import SensorNoise
from valor.simulation.plant import Plant

SUPPLY = 48.0  # of a robot without batteries [V]
DRAIN_EVERY = 10_000_000  # period of computing the batteries' voltage [ns]


class Sensors:
    """All sensors.

    Positions and velocities are those of the present instant, accelerations and forces those of the last physics step.
    True values and noise are one vector each::

        joint position | velocity | effort | gyroscope | accelerometer | 4 wrenches | attitude error
              n             n         n          3             3             24             3
    """

    def __init__(self, robot: RobotDescription, plant: Plant, noise: SensorNoise, seed: int) -> None:
        self._plant = plant
        model, mj, data = plant.model, plant.model.mj, plant.data
        tables, feet = robot.tables, robot.tables.feet
        self._n = n = len(robot.joints)
        self._imu = model.site(tables.imu.site)
        if mj.site_bodyid[self._imu] != model.body(tables.base):
            raise ConfigurationError(f"{robot.model_file}: site {tables.imu.site!r}: expected on {tables.base!r}")
        self._imu_in_base = mj.site_quat[self._imu].copy()
        self._base_orientation, self._base_rate = data.qpos[3:7], data.qvel[3:6]
        self._acceleration = np.zeros(6)
        self._wrenches = WrenchSensors(
            plant,
            [
                *((foot.body, foot.sole) if tables.feet_are_sensed else None for foot in (feet.left, feet.right)),
                *(None if hand is None else (hand.body, hand.site) for hand in (tables.hands.left, tables.hands.right)),
            ],
        )
        self._complete = completion(robot)
        self._supply = Supply(robot, tables.batteries) if tables.batteries else None
        self._kvh = Kvh(robot, plant, noise != SensorNoise(), seed) if tables.kvh else None
        self._rng = np.random.default_rng([seed, 1])
        self._resolution = noise.joint_position_resolution
        deviation = [noise.joint_position] * n + [noise.joint_velocity] * n + [noise.joint_effort] * n
        deviation += [noise.gyroscope] * 3 + [noise.accelerometer] * 3
        for place in self._wrenches.places:
            deviation += [noise.force] * 3 + [noise.torque] * 3 if place else [0.0] * 6
        deviation += [noise.orientation] * 3
        self._deviation = np.array(deviation)
        self._noise, self._truth = np.zeros(self._deviation.size), np.zeros(self._deviation.size)
        self._truth[-3:-1] = self._rng.standard_normal(2) * noise.orientation_bias  # roll and pitch

    def measure(self, sequence: int, time: int) -> Proprioceptor:
        plant, n, truth = self._plant, self._n, self._truth
        model, data = plant.model, plant.data
        mujoco.mj_rnePostConstraint(model.mj, data)
        mujoco.mj_objectAcceleration(model.mj, data, mujoco.mjtObj.mjOBJ_SITE, self._imu, self._acceleration, 1)
        k = 3 * n
        truth[:n] = data.qpos[model.qpos]
        truth[n : 2 * n] = data.qvel[model.dof]
        truth[2 * n : k] = plant.actuators.effort
        mujoco.mju_rotVecQuat(truth[k : k + 3], self._base_rate, self._imu_in_base * _CONJUGATE)
        truth[k + 3 : k + 6] = self._acceleration[3:]
        truth[k + 6 : k + 30] = self._wrenches.measure().ravel()
        second = self._kvh.measure() if self._kvh else np.zeros((2, 0))
        self._rng.standard_normal(out=self._noise)
        values = self._noise * self._deviation
        values += truth
        position = values[:n]
        if self._resolution:
            position /= self._resolution
            np.rint(position, out=position)
            position *= self._resolution
        measured = Proprioceptor(
            time=time,
            sequence=sequence,
            motor_sequence=plant.actuators.motor_sequence,
            joint_position=position,
            joint_velocity=values[n : 2 * n],
            joint_effort=values[2 * n : k],
            imu_orientation=self._orientation(values[-3:]),
            imu_angular_velocity=values[k : k + 3],
            imu_linear_acceleration=values[k + 3 : k + 6],
            kvh_angular_velocity=second[0],
            kvh_linear_acceleration=second[1],
            left_foot_wrench=values[k + 6 : k + 12],
            right_foot_wrench=values[k + 12 : k + 18],
            left_hand_wrench=values[k + 18 : k + 24],
            right_hand_wrench=values[k + 24 : k + 30],
            battery_voltage=self._supply.drain(time, truth[n : 2 * n], plant.actuators.effort)
            if self._supply
            else SUPPLY,
            motor_behavior="",
        )
        return self._complete(measured)

    def _orientation(self, error: FloatArray) -> FloatArray:
        """(4,) attitude of the IMU in world, rotated by a small rotation vector (3,) in the IMU's frame [rad]."""
        orientation = np.empty(4)
        mujoco.mju_mulQuat(orientation, self._base_orientation, self._imu_in_base)
        mujoco.mju_quatIntegrate(orientation, error, 1.0)
        return orientation


class Supply:
    """Simulated batteries."""

    def __init__(self, robot: RobotDescription, table: Batteries) -> None:
        self._table, self._limit, self._share, self._time = table, robot.effort_limit, table.charge, 0
        self._voltage = 0.0  # latest

    def drain(self, time: int, velocity: FloatArray, effort: FloatArray) -> float:
        """Draw what the joints have needed until robot ``time`` [ns]; returns the voltage [V]."""
        if self._voltage and 0 <= time - self._time < DRAIN_EVERY:
            return self._voltage
        table, power = self._table, self._table.power(effort, velocity, self._limit)
        self._voltage = table.voltage(self._share, power)
        hours, self._time = 1e-9 * (time - self._time) / 3600.0, time
        self._share = max(0.0, self._share - power / self._voltage * hours / table.whole)
        return self._voltage


class Kvh:
    """Second IMU, a KVH 1750 with the noise that its maker states: white, with a bias that is constant in a run."""

    def __init__(self, robot: RobotDescription, plant: Plant, noisy: bool, seed: int) -> None:
        """``noisy``: False for an ideal sensor."""
        assert robot.tables.kvh is not None
        self._plant = plant
        self._site = plant.model.site(robot.tables.kvh.site)
        self._to_site = plant.model.mj.site_quat[self._site] * _CONJUGATE
        self._rng = np.random.default_rng([seed, 2])  # separate: the noise of the other sensors does not depend on it
        self._deviation = noisy * math.sqrt(robot.tables.control_rate) * np.array(DENSITIES)[:, None]
        self._bias = noisy * np.array(BIASES)[:, None] * self._rng.standard_normal((2, 3))
        self._acceleration = np.zeros(6)

    def measure(self) -> FloatArray:
        """(2, 3) angular velocity and specific force in its axes; call after ``mj_rnePostConstraint``."""
        mj, data, values = self._plant.model.mj, self._plant.data, np.empty((2, 3))
        mujoco.mju_rotVecQuat(values[0], data.qvel[3:6], self._to_site)
        mujoco.mj_objectAcceleration(mj, data, mujoco.mjtObj.mjOBJ_SITE, self._site, self._acceleration, 1)
        values[1] = self._acceleration[3:]
        values += self._bias + self._deviation * self._rng.standard_normal((2, 3))
        return values


class WrenchSensors:
    """Force/torque sensors: external wrench on a body and all its descendants, in a site's frame.

    Real sensors also measure the weight of these bodies; their drivers subtract it. A missing sensor measures 0,
    without noise.
    """

    def __init__(self, plant: Plant, places: list[tuple[str, str] | None]) -> None:
        mj, data = plant.model.mj, plant.data
        self.places = places  # body and site of each of m sensors; None: missing
        self._forces = data.cfrc_ext  # (nbody, 6) torque and force in world axes, about the robot's CoM
        self._sum = np.zeros((len(places), mj.nbody))  # bodies that each sensor carries
        self._sites = []
        for row, names in enumerate(places):
            place = 0
            if names is not None:
                top, place = plant.model.body(names[0]), plant.model.site(names[1])
                self._sum[row] = [_carries(mj, top, b) for b in range(mj.nbody)]
            self._sites.append((data.site_xpos[place], data.site_xmat[place]))
        self._com = data.subtree_com[plant.model.body(plant.model.robot.tables.base)]
        self._in_site = np.zeros((len(places), 6))

    def measure(self) -> FloatArray:
        """(m, 6) force [N] and torque [N·m] at the sites, in their axes; call after ``mj_rnePostConstraint``."""
        about_com = self._sum @ self._forces
        for (position, axes), wrench, in_site in zip(self._sites, about_com, self._in_site, strict=True):
            mujoco.mju_transformSpatial(in_site, wrench, 1, position, self._com, axes)
        return self._in_site[:, _FORCE_FIRST]


_FORCE_FIRST = np.array([3, 4, 5, 0, 1, 2])
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


def _carries(mj: mujoco.MjModel, top: int, body: int) -> bool:
    while body > top:
        body = mj.body_parentid[body]
    return bool(body == top)
