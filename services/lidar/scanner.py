"""Hokuyo UTM-30LX-EW by MuJoCo's rays: a sensor that moves during a scan, the world and the robot's own shapes."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.messages import GroundTruth
from valor.robot.description import RobotDescription
from valor.robot.model import Model, matrix
from valor.simulation import worlds
from valor.simulation.height_fields import triangles
from valor.simulation.plant import scene

# Data sheet: 270° in steps of 0.25°, 40 Hz; accuracy ±30 mm to 10 m, ±50 mm beyond, here three standard deviations.
BEAMS = 1081
STEP = math.radians(0.25)
FIRST = -0.5 * (BEAMS - 1) * STEP  # angle about the sensor's z axis, from x [rad]
PERIOD = 25_000_000  # from one scan to the next [ns]
INCREMENT = PERIOD / 1440  # from one beam to the next, 1440 in a turn of the mirror [ns]
NEAREST, FARTHEST = 0.1, 30.0  # [m]
NEAR = 10.0  # Distance of the change of noise [m]
ACCURACY = (0.030, 0.050)  # bound of the noise, nearer and farther [m]
PIECES = 9  # of a scan, each with the robot in one posture
_BEAMS_OF_PIECE = (BEAMS - 1) // PIECES
KNOTS = np.rint(np.arange(PIECES + 1) * _BEAMS_OF_PIECE * INCREMENT).astype(np.int64)
"""(PIECES + 1,) times of the ends of all pieces after the first beam [ns]."""

_angles = FIRST + STEP * np.arange(BEAMS)
_IN_SENSOR = np.column_stack([np.cos(_angles), np.sin(_angles)])  # (BEAMS, 2) directions; z is 0
_PIECE = np.minimum(np.arange(BEAMS) // _BEAMS_OF_PIECE, PIECES - 1)
_SHARE = (np.arange(BEAMS) / _BEAMS_OF_PIECE - _PIECE)[:, None, None]


@dataclass(frozen=True)
class Scan:
    """One scan.

    Attributes:
        ranges: (BEAMS,) as REP 117 has them: inf beyond the range, −inf below it, NaN on the robot itself [m].
        in_base: (PIECES + 1, 4, 4) poses of the sensor in the robot's base at ``KNOTS``.
    """

    ranges: FloatArray
    in_base: FloatArray

    def points(self, base: FloatArray) -> tuple[FloatArray, npt.NDArray[np.intp]]:
        """Return (k, 3) points [m] and (k,) numbers of the beams that met something.

        ``base``: (PIECES + 1, 7) poses of the base at ``KNOTS``; the points are in its frame.
        """
        frames = np.array([_frame(pose[:3], matrix(pose[3:])) for pose in base]) @ self.in_base
        beams = np.flatnonzero(np.isfinite(self.ranges))
        piece = _PIECE[beams]
        frame = frames[piece] + _SHARE[beams] * (frames[piece + 1] - frames[piece])
        flat = self.ranges[beams, None] * _IN_SENSOR[beams]
        return np.einsum("bij,bj->bi", frame[:, :3, :2], flat) + frame[:, :3, 3], beams


class Scanner:
    """The sensor in a world. Raises ConfigurationError: the robot has no lidar, or the world does not exist."""

    def __init__(self, robot: RobotDescription, world: str, seed: int) -> None:
        if robot.tables.lidar is None:
            raise ConfigurationError(f"{robot.name}: no lidar in robot.yaml")
        self.lidar = lidar = robot.tables.lidar
        spec = scene(robot, world, seed, "collision")
        _make_meshes(spec)
        self._model = Model(robot, spec.compile())
        mj = self._model.mj
        self._data = mujoco.MjData(mj)
        self._fixtures = worlds.joints(mj)
        self._nominal = self._model.nominal_qpos()
        self._base, self._body = self._model.body(robot.tables.base), self._model.body(lidar.body)
        self._mount = _frame(lidar.position, np.eye(3))
        self.spindle = int(mj.jnt_qposadr[mj.body_jntadr[self._body]])  # index of its angle in a configuration
        self._own = np.append(mj.body_rootid[mj.geom_bodyid] == mj.body_rootid[self._base], False)  # last: no geom
        self._random = np.random.default_rng(seed)

    def configuration(self, truth: GroundTruth) -> FloatArray:
        """Return ``qpos`` (nq,) of robot and world."""
        qpos, model = self._nominal.copy(), self._model
        qpos[:3], qpos[3:7] = truth.pelvis_position_in_world, truth.pelvis_orientation_in_world
        qpos[model.qpos] = truth.joint_position[model.joint_indices]
        if truth.fixture_position.size == self._fixtures.size:
            qpos[self._fixtures] = truth.fixture_position
        return qpos

    def scan(self, configurations: FloatArray) -> Scan:
        """Scan with (PIECES + 1, nq) configurations at ``KNOTS``."""
        sensor, base = np.empty((PIECES + 1, 4, 4)), np.empty((PIECES + 1, 4, 4))
        distance, met = np.empty(BEAMS), np.empty(BEAMS, dtype=np.int32)
        data = self._data
        for knot, configuration in enumerate(configurations):
            data.qpos[:] = configuration
            mujoco.mj_kinematics(self._model.mj, data)
            base[knot] = _frame(data.xpos[self._base], data.xmat[self._base].reshape(3, 3))
            sensor[knot] = _frame(data.xpos[self._body], data.xmat[self._body].reshape(3, 3)) @ self._mount
            if knot:
                beams = slice((knot - 1) * _BEAMS_OF_PIECE, BEAMS if knot == PIECES else knot * _BEAMS_OF_PIECE)
                rays = _rays(sensor[knot - 1], sensor[knot], beams)
                middle = sensor[knot - 1 : knot + 1, :3, 3].mean(axis=0)
                mujoco.mj_multiRay(
                    self._model.mj, data, middle, rays.ravel(), None, True, self._body, met[beams], distance[beams],
                    None, len(rays), FARTHEST + 1.0,
                )  # fmt: skip
        return Scan(self._measured(distance, met), np.linalg.inv(base) @ sensor)

    def _measured(self, distance: FloatArray, met: npt.NDArray[np.int32]) -> FloatArray:
        bound = np.array(ACCURACY)[(distance > NEAR).astype(int)]
        ranges: FloatArray = distance + bound * np.clip(self._random.standard_normal(BEAMS) / 3.0, -1.0, 1.0)
        ranges[(distance < 0.0) | (ranges > FARTHEST)] = math.inf
        ranges[ranges < NEAREST] = -math.inf
        ranges[self._own[met]] = math.nan
        return ranges


def _rays(first: FloatArray, last: FloatArray, beams: slice) -> FloatArray:
    """(m, 3) directions of a piece's beams, at whose ends the sensor has the poses (4, 4)."""
    rotation = first[:3, :2] + _SHARE[beams] * (last - first)[:3, :2]
    rays: FloatArray = np.einsum("bij,bj->bi", rotation, _IN_SENSOR[beams])
    return rays


def _make_meshes(spec: mujoco.MjSpec) -> None:
    """Replace height fields by meshes, in which rays take a third of the time."""
    fields = [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_HFIELD]
    model = spec.compile()
    for geom in fields:
        name, geom.hfieldname = geom.hfieldname, ""
        vertices, faces = triangles(model, model.hfield(name).id)
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.add_mesh(name=name, uservert=vertices.ravel(), userface=faces.ravel().astype(int), inertia=shell)
        geom.type, geom.meshname, geom.contype, geom.conaffinity = mujoco.mjtGeom.mjGEOM_MESH, name, 0, 0
    for field in list(spec.hfields):
        spec.delete(field)


def _frame(position: FloatArray | tuple[float, float, float], rotation: FloatArray) -> FloatArray:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation, position
    return frame
