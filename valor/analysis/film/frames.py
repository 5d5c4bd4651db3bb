"""Storyboard of a film: posture, camera and marks of each picture."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d

from valor.analysis.film.moments import CONTROLLER, JOINTS, ODOMETRY, STATE, TRUTH, Moment, Moments
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray
from valor.common.poses import Pose
from valor.common.rotation import heading, quaternion
from valor.drawing import Posture, marks
from valor.drawing.marks import Mark
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot.motion_tables import WHOLE_BODY

TRUE, BELIEVED, STANDING = "the simulator's truth", "the robot's estimate", "a fixed base"
_ESCHER = 80.0 * 9.81  # weight for which ``METRES_A_NEWTON`` is the scale of arrows [N]
_CALM = 0.5  # standard deviation of the smoothing of a following camera [s]


@dataclass(frozen=True)
class Camera:
    """Position relative to the robot at the start of the film."""

    azimuth: float  # direction of view from the robot's heading, anticlockwise [degrees]
    elevation: float  # direction of view, up [degrees]
    distance: float = 1.5  # to the point of view, in heights of the robot
    height: float = 0.5  # of that point over the soles, in heights of the robot
    follows: bool = True  # whether that point moves with the robot; else it stays in the middle of the path


# fmt: off
CAMERAS = {
    "follow":   Camera(148.0, -10.0),
    "front":    Camera(180.0, -6.0),
    "back":     Camera(0.0, -12.0),
    "left":     Camera(-90.0, -6.0),
    "right":    Camera(90.0, -6.0),
    "above":    Camera(0.0, -89.0, 2.2),
    "feet":     Camera(125.0, -14.0, 0.75, 0.12),
    "hands":    Camera(140.0, -14.0, 1.05, 0.66),
    "shoulder": Camera(42.0, -14.0, 1.15, 0.62),
    "fixed":    Camera(125.0, -12.0, 1.75, 0.4, follows=False),
}
# fmt: on


@dataclass(frozen=True)
class View:
    """A camera for one picture, in world."""

    point: FloatArray  # (3,) point of view [m]
    azimuth: float  # [degrees]
    elevation: float  # [degrees]
    distance: float  # [m]


def views(camera: Camera, positions: FloatArray, heading: float, size: float, step: float) -> list[View]:
    """Compute the camera of every picture, ``step`` apart [s].

    ``positions`` (n, 3) are of the robot's middle, at the height of the soles, in world [m]; ``heading`` [rad] is at
    the start; ``size`` is the robot's height [m].
    """
    way = 0.0
    if camera.follows:
        points = gaussian_filter1d(positions, _CALM / step, axis=0, mode="nearest")
    else:
        low, high = positions.min(axis=0), positions.max(axis=0)
        points, way = np.broadcast_to((low + high) / 2.0, positions.shape), float(np.linalg.norm((high - low)[:2]))
    up = np.array([0.0, 0.0, camera.height * size])
    azimuth = camera.azimuth + float(np.rad2deg(heading))
    return [View(point + up, azimuth, camera.elevation, camera.distance * size + 0.6 * way) for point in points]


@dataclass(frozen=True)
class Frame:
    """One picture."""

    posture: Posture
    view: View
    marks: list[Mark]
    controller: str = ""  # in control, of a robot that has several


@dataclass(frozen=True)
class Storyboard:
    """All frames in order, and the source of the base pose."""

    frames: list[Frame]
    base: str


def _forces(body: _Body, moment: Moment, soles: Sequence[Pose], _over: Pose) -> list[Mark]:
    if JOINTS[0] not in moment:
        return []
    sides = ("left", "right")
    wrenches = np.array([getattr(moment[JOINTS[0]], f"{side}_foot_wrench") for side in sides])
    return marks.forces(soles, wrenches, marks.METRES_A_NEWTON * _ESCHER / body.weight)


def _dcm(body: _Body, moment: Moment, soles: Sequence[Pose], over: Pose) -> list[Mark]:
    """Estimated CoM, DCM and CoP, relative to the drawn robot."""
    if STATE not in moment:
        return []
    state = moment[STATE]
    stands = [bool(each) for each in state.contacts]
    grounds = [sole.position[2] for sole, is_down in zip(soles, stands, strict=True) if is_down]
    ground = float(np.mean(grounds or [min(sole.position[2] for sole in soles)]))

    def there(point: Any) -> FloatArray:
        x, y, *z = map(float, point)
        return np.array((over @ Pose((x, y, z[0] if z else 0.0))).position)

    com, dcm, reference = map(there, (state.com_in_odom, state.dcm_in_odom, state.dcm_reference_in_odom))
    cop = there(state.cop_in_odom)[:2] if np.isfinite(state.cop_in_odom).all() else np.full(2, math.nan)
    return marks.support(soles, stands, body.robot.tables.feet) + marks.balance(com, dcm, reference, cop, ground)


OVERLAYS: dict[str, Callable[[_Body, Moment, Sequence[Pose], Pose], list[Mark]]] = {"forces": _forces, "dcm": _dcm}
"""Marks drawn around the robot; ``MODES`` is a caption."""
MODES = "modes"


class _Body:
    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self._model = full_model(robot, "all")
        self._data = mujoco.MjData(self._model.mj)
        self._data.qpos[:] = self._model.nominal_qpos()
        mujoco.mj_forward(self._model.mj, self._data)
        self.weight = 9.81 * float(self._model.mj.body_mass.sum())
        boxes = np.abs(self._data.geom_xmat.reshape(-1, 3, 3)[:, 2])
        tops = self._data.geom_xpos[:, 2] + np.einsum("gj,gj->g", boxes, self._model.mj.geom_aabb[:, 3:])
        self.size = float(tops.max())  # [m]
        self._feet = [self._model.site(foot.sole) for foot in (robot.tables.feet.left, robot.tables.feet.right)]

    def soles(self, posture: Posture) -> tuple[Pose, Pose]:
        """Poses of the left and right sole in world."""
        data, model = self._data, self._model
        data.qpos[:3], data.qpos[3:7] = posture.pelvis_position, posture.pelvis_orientation
        data.qpos[model.qpos] = posture.joint_position[model.joint_indices]
        mujoco.mj_kinematics(model.mj, data)
        left, right = (self._pose(site) for site in self._feet)
        return left, right

    def _pose(self, site: int) -> Pose:
        turned = np.zeros(4)
        mujoco.mju_mat2Quat(turned, self._data.site_xmat[site])
        x, y, z = map(float, self._data.site_xpos[site])
        return Pose((x, y, z), quaternion(map(float, turned)))


def plan(robot: RobotDescription, moments: Moments, camera: Camera, overlays: Collection[str]) -> Storyboard:
    """Make the storyboard. Raises ``BagError``: the recording is of a robot with other joints."""
    body = _Body(robot)
    base = next((word for topic, word in _BASES.items() if topic in moments.known[0]), STANDING)
    postures = [_posture(robot, time, moment) for time, moment in zip(moments.times, moments.known, strict=True)]
    soles = [body.soles(posture) for posture in postures]
    places = np.array([posture.pelvis_position for posture in postures])
    places[:, 2] = [min(sole.position[2] for sole in pair) for pair in soles]
    step = moments.times[1] - moments.times[0] if len(moments.times) > 1 else 1.0
    seen = views(camera, places, heading(postures[0].pelvis_orientation.tolist()), body.size, step)
    frames = []
    for posture, moment, pair, view in zip(postures, moments.known, soles, seen, strict=True):
        over = _world_over_odom(posture, moment)
        drawn = [mark for name in OVERLAYS if name in overlays for mark in OVERLAYS[name](body, moment, pair, over)]
        frames.append(Frame(posture, view, drawn, _controller(moment)))
    return Storyboard(frames, base)


_BASES = {TRUTH: TRUE, STATE: BELIEVED, ODOMETRY: BELIEVED}


def _posture(robot: RobotDescription, time: float, moment: Moment) -> Posture:
    position, orientation = np.array([0.0, 0.0, robot.tables.nominal_base_height]), np.array([1.0, 0.0, 0.0, 0.0])
    if TRUTH in moment:
        truth = moment[TRUTH]
        position, orientation = truth.pelvis_position_in_world, truth.pelvis_orientation_in_world
    elif STATE in moment:
        position, orientation = _believed(moment)
    elif ODOMETRY in moment:
        p, q = moment[ODOMETRY].pose.pose.position, moment[ODOMETRY].pose.pose.orientation
        position, orientation = np.array([p.x, p.y, p.z]), np.array([q.w, q.x, q.y, q.z])
    fixtures = getattr(moment.get(TRUTH), "fixture_position", ())  # absent in older recordings
    behavior = str(moment[STATE].behavior) if STATE in moment else ""
    joints = _joints(robot, moment)
    return Posture(time, behavior, np.array(position), np.array(orientation), joints, np.array(fixtures, dtype=float))


def _believed(moment: Moment) -> tuple[FloatArray, FloatArray]:
    return moment[STATE].pelvis_position_in_odom, moment[STATE].pelvis_orientation_in_odom


def _controller(moment: Moment) -> str:
    status = moment.get(CONTROLLER)  # absent in older recordings
    return "" if status is None or {*status.stand, *status.walk} == {WHOLE_BODY} else str(status.active)


def _joints(robot: RobotDescription, moment: Moment) -> FloatArray:
    """(n,) measured positions [rad]; nominal ones where there is no measurement."""
    if JOINTS[0] in moment:
        measured = np.array(moment[JOINTS[0]].joint_position, dtype=np.float64)
        if measured.shape != (len(robot.joints),):
            raise BagError(f"{JOINTS[0]}: {measured.size} joints; robot {robot.name!r} has {len(robot.joints)}")
        return measured
    positions = robot.nominal_posture.copy()
    known = dict(zip(moment[JOINTS[1]].name, moment[JOINTS[1]].position, strict=False))
    if not known.keys() & set(robot.joints):
        raise BagError(f"{JOINTS[1]}: none of the joints of robot {robot.name!r}; it has {', '.join(known)}")
    for joint, place in robot.index.items():
        positions[place] = known.get(joint, positions[place])
    return positions


def _world_over_odom(posture: Posture, moment: Moment) -> Pose:
    """Pose of odom in world under which the estimated pose of the robot is the drawn one."""
    if STATE not in moment:
        return Pose()
    drawn, believed = (
        Pose((float(position[0]), float(position[1]), float(position[2])), quaternion(map(float, orientation)))
        for position, orientation in ((posture.pelvis_position, posture.pelvis_orientation), _believed(moment))
    )
    return drawn @ believed.inverse()
