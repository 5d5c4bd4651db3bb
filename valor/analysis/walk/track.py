"""Metrics of a walk, from a bag or from messages received live, and its footprints."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import mujoco
import numpy as np
import numpy.typing as npt

from valor.analysis.reading.bag import Series
from valor.analysis.reading.recording import Recording, nearest, recorded
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray
from valor.common.behaviors import STEPPING, WALKING, Behavior
from valor.common.messages import MotionState, Proprioceptor
from valor.common.topics import CLOCK, GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.robot.legs import knees
from valor.robot.model import full_model

MOVING = 0.05  # speed below which a walk has ended [m/s]
STEPS = (*STEPPING, *WALKING)  # behaviors in which the robot walks
SHORTEST_PRINT = 0.15  # minimum contact of a footprint [s]
_VERTICAL = 2  # of a wrench


@dataclass(frozen=True)
class Track:
    """States of the Motion Manager with the measurements they answer; n control periods, ascending."""

    time: FloatArray  # (n,) robot time [s]
    sequence: npt.NDArray[np.int64]  # (n,) of the Proprioceptor that each answers
    walking: npt.NDArray[np.bool_]  # (n,) in a behavior that walks
    fallen: npt.NDArray[np.bool_]  # (n,)
    pelvis: FloatArray  # (n, 3) in odom [m]
    speed: FloatArray  # (n,) of the pelvis [m/s]
    dcm_error: FloatArray  # (n, 3) from its reference [m]
    desired_force: FloatArray  # (n, 2) vertical, left and right, as planned [N]
    measured_force: FloatArray  # (n, 2) the foot sensors' in the same period [N]
    knee: FloatArray  # (n, 2) flexion [rad]
    tick: FloatArray  # (n,) [s]
    qp_failures: npt.NDArray[np.int64]  # (n,) since start
    saturations: npt.NDArray[np.int64]  # (n,) since start

    @classmethod
    def of(cls, recording: Recording) -> Self:
        """From a bag. Raises ``BagError``: the bag lacks a topic; names it."""
        recording.load(MOTION_STATE, PROPRIOCEPTOR)
        states, measured = recording.series(MOTION_STATE), recording.series(PROPRIOCEPTOR)
        recording.joints(PROPRIOCEPTOR, "joint_position")  # raises BagError for another robot
        answered = nearest(measured["sequence"], states["proprioceptor_sequence"])
        return cls._of(states, measured, answered, recording.robot)

    @classmethod
    def from_messages(cls, states: list[MotionState], measured: list[Proprioceptor], robot: RobotDescription) -> Self:
        """From messages received live; states without their measurement are left out."""
        rows = {each.sequence: row for row, each in enumerate(measured)}
        both = [state for state in states if state.proprioceptor_sequence in rows]
        if not both:
            nothing: Any = np.empty(0)
            return cls(*(nothing for _ in fields(cls)))
        answered = np.array([rows[state.proprioceptor_sequence] for state in both])
        return cls._of(
            Series.from_messages(MOTION_STATE, both), Series.from_messages(PROPRIOCEPTOR, measured), answered, robot
        )

    @classmethod
    def _of(cls, states: Series, measured: Series, answered: npt.NDArray[np.intp], robot: RobotDescription) -> Self:
        """``answered``: rows of ``measured`` that the states answer."""
        behaviors = states.strings("behavior")
        feet = [measured[f"{side}_foot_wrench"][answered, _VERTICAL] for side in ("left", "right")]
        return cls(
            time=states.time,
            sequence=states["proprioceptor_sequence"].astype(np.int64),
            walking=np.isin(behaviors, STEPS),
            fallen=behaviors == Behavior.FALL,
            pelvis=states["pelvis_position_in_odom"],
            speed=np.linalg.norm(states["pelvis_linear_velocity_in_odom"], axis=1),
            dcm_error=states["dcm_in_odom"] - states["dcm_reference_in_odom"],
            desired_force=states["desired_foot_forces"],
            measured_force=np.column_stack(feet),
            knee=knees(robot).flexion(measured["joint_position"][answered]),
            tick=states["tick_time"],
            qp_failures=states["qp_failures"].astype(np.int64),
            saturations=states["torque_saturations"].astype(np.int64),
        )

    @classmethod
    def joined(cls, pieces: Sequence[Self]) -> Self:
        """Concatenate consecutive pieces; at least one."""
        return cls(
            **{each.name: np.concatenate([getattr(piece, each.name) for piece in pieces]) for each in fields(cls)}
        )

    def between(self, first: float, last: float) -> Self:
        """The part between two times [s]."""
        inside = (self.time >= first) & (self.time <= last)
        return type(self)(**{each.name: getattr(self, each.name)[inside] for each in fields(self)})

    def walk(self) -> tuple[float, float]:
        """Start of the first motion, and end: rest, fall or standing behavior [s]. BagError: the robot never walked."""
        moving = np.flatnonzero(self.walking & (self.speed > MOVING))
        if not moving.size:
            raise BagError("the robot never walked")
        first = float(self.time[moving[0]])
        after = np.flatnonzero(self.fallen & (self.time > first))
        return first, float(self.time[after[0]] if after.size else self.time[moving[-1]])


@dataclass(frozen=True)
class WalkMetrics:
    """Metrics of a walk, from estimated and measured values."""

    distance: float  # of the pelvis, from first to last [m]
    duration: float  # [robot time, s]
    fell: bool
    dcm_error: tuple[float, float, float]  # root mean square, x, y, z in odom [m]
    knee: float  # the smallest flexion [rad]
    saturations: int  # joint commands clamped by effort limits
    force_error: float  # vertical, planned against measured one period later, root mean square of both feet [N]
    force_error_median: float  # of its magnitude [N]
    qp_failures: int
    tick_median: float  # [s]
    tick_99: float  # [s]
    ticks: int

    @property
    def speed(self) -> float:
        """Mean [m/s]."""
        return self.distance / self.duration if self.duration else 0.0

    @classmethod
    def of(cls, track: Track) -> Self:
        """From a track that contains only the walk."""
        way = track.pelvis[-1] - track.pelvis[0]
        follows = np.flatnonzero(np.diff(track.sequence) == 1)
        force = track.measured_force[follows + 1] - track.desired_force[follows]
        x, y, z = np.sqrt(np.mean(track.dcm_error**2, axis=0)).tolist()
        return cls(
            distance=float(np.hypot(way[0], way[1])),
            duration=float(track.time[-1] - track.time[0]),
            fell=bool(track.fallen.any()),
            dcm_error=(x, y, z),
            knee=float(track.knee.min()),
            saturations=int(track.saturations[-1] - track.saturations[0]),
            force_error=float(np.sqrt(np.mean(force**2))),
            force_error_median=float(np.median(np.abs(force))),
            qp_failures=int(track.qp_failures[-1] - track.qp_failures[0]),
            tick_median=float(np.median(track.tick)),
            tick_99=float(np.percentile(track.tick, 99)),
            ticks=len(track.tick),
        )


@dataclass(frozen=True)
class Timeliness:
    """Timing of the system in a walk."""

    deadlines_missed: int  # ticks of the Motion Manager that took longer than the control period
    waits_timed_out: int  # waits of the Comms Manager for a Motor
    slip: float  # robot time behind the wall clock [s]

    @classmethod
    def of(cls, recording: Recording, walk: Track) -> Self:
        """From a bag, over the time of ``walk``; without the clock's topic its values are 0."""
        waits, slip = 0, 0.0
        if recording.has(CLOCK):
            clock = recording.series(CLOCK)
            ends = nearest(clock.time, walk.time[[0, -1]])
            waits = int(np.diff(clock["waits_timed_out"][ends])[0])
            slip = float(np.diff(clock["slip"][ends])[0])
        missed = int(np.count_nonzero(walk.tick > recording.robot.control_period))
        return cls(missed, waits, slip)


@dataclass(frozen=True)
class Footprint:
    """One contact of a sole with the ground."""

    left: bool
    time: float  # middle of the contact, robot time [s]
    position: FloatArray  # (3,) of the sole in world [m]
    heading: float  # [rad]


def footprints(recording: Recording) -> list[Footprint]:
    """All footprints, from the simulator's truth, in order of time.

    Raises BagError: the bag has no ground truth, or no foot was ever in contact.
    """
    truth = recording.series(GROUND_TRUTH)
    contacts, times = truth["contacts"], truth.time
    pelvis = np.hstack([truth["pelvis_position_in_world"], truth["pelvis_orientation_in_world"]])
    joints = recording.joints(GROUND_TRUTH, "joint_position")
    model = full_model(recording.robot)
    data = mujoco.MjData(model.mj)
    feet = recording.robot.tables.feet
    found = []
    for column, foot in enumerate((feet.left, feet.right)):
        site = model.site(foot.sole)
        for first, last in runs(contacts[:, column] > 0):
            if times[last] - times[first] < SHORTEST_PRINT:
                continue
            middle = (first + last) // 2
            data.qpos[:7], data.qpos[model.qpos] = pelvis[middle], joints[middle][model.joint_indices]
            mujoco.mj_kinematics(model.mj, data)
            axes = data.site_xmat[site].reshape(3, 3)
            heading = float(np.arctan2(axes[1, 0], axes[0, 0]))
            found.append(Footprint(column == 0, float(times[middle]), data.site_xpos[site].copy(), heading))
    if not found:
        raise BagError(f"{recording.bag.path}: no foot in contact on {recorded(GROUND_TRUTH)}; expected at least one")
    return sorted(found, key=lambda each: each.time)


def runs(flags: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of every run of true values."""
    edges = np.diff(np.concatenate(([0], flags.astype(np.int8), [0])))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))


def named(metrics: WalkMetrics, timeliness: Timeliness) -> dict[str, Any]:
    """Machine-readable report: names end with their unit; counts have none."""
    x, y, z = metrics.dcm_error
    return {
        "dcm_error_rms_m": {"x": x, "y": y, "z": z},
        "smallest_knee_angle_rad": metrics.knee,
        "torque_saturations": metrics.saturations,
        "foot_force_error_rms_n": metrics.force_error,
        "foot_force_error_median_n": metrics.force_error_median,
        "solver_failures": metrics.qp_failures,
        "ticks": metrics.ticks,
        "tick_median_s": metrics.tick_median,
        "tick_p99_s": metrics.tick_99,
        "deadlines_missed": timeliness.deadlines_missed,
        "waits_timed_out": timeliness.waits_timed_out,
        "clock_slip_s": timeliness.slip,
    }


def rows(metrics: WalkMetrics, timeliness: Timeliness) -> list[tuple[str, str]]:
    """Human-readable report: names and values."""
    x, y, z = (1e3 * each for each in metrics.dcm_error)
    return [
        ("DCM error, rms", f"{x:.1f}, {y:.1f}, {z:.1f} mm (x, y, z)"),
        ("smallest knee angle", f"{metrics.knee:.2f} rad"),
        ("torques clamped at their limit", str(metrics.saturations)),
        (
            "vertical foot force, planned against measured",
            f"{metrics.force_error:.0f} N rms, {metrics.force_error_median:.1f} N median",
        ),
        ("solver failures", str(metrics.qp_failures)),
        ("tick", f"{1e3 * metrics.tick_median:.2f} ms median, {1e3 * metrics.tick_99:.2f} ms p99"),
        ("deadlines missed", f"{timeliness.deadlines_missed} of {metrics.ticks}"),
        ("waits timed out", str(timeliness.waits_timed_out)),
        ("clock slip", f"{timeliness.slip:.2f} s"),
    ]
