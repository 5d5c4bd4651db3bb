"""What a bag has of the three pathways, on the wall clock's axis: the tap points of the thesis' figure 4.4."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from valor.analysis.reading.bag import Bag, Series
from valor.analysis.reading.recording import Recording, recorded
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray
from valor.common.topics import HDT_COMMANDS, HDT_STATES, JOINT_SETPOINTS, MOTION_STATE, MOTOR, PROPRIOCEPTOR
from valor.robot.description import RobotDescription

ARM = "right_arm"
CONTROLLER = f"/trajectory_controllers/{ARM}_traj_controller"
REFERENCE, VEC = f"{CONTROLLER}/joint_trajectory", f"{CONTROLLER}/controller_state"
MODE_COMMAND, MODE_REPORT = "/flor/controller/mode_command", "/flor/controller/mode"
JOINT_STATES = "/joint_states"
_TOLD = (PROPRIOCEPTOR, MOTOR, MOTION_STATE, JOINT_SETPOINTS)
_DRIVEN = (HDT_COMMANDS[ARM], HDT_STATES[ARM])
_ROS = (REFERENCE, VEC, JOINT_STATES, MODE_COMMAND, MODE_REPORT)
TOPICS = (*(recorded(topic) for topic in (*_TOLD, *_DRIVEN)), *_ROS)

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Motion:
    """A trajectory that was asked for.

    Attributes:
        asked: when [s].
        end: when it ended, as robot time goes [s].
        joints: that it moves.
    """

    asked: float
    end: float
    joints: frozenset[str]


class Taps:
    """The series of a bag of motions that were asked for as JointTrajectory messages, and of mode changes.

    Attributes:
        senses, motor, states, setpoints: Proprioceptor, Motor, MotionState and JointSetpoints.
        hdt_commands, hdt_states: of the arm's driver; None in a simulation without one.
        references, vec, joint_states, mode_commands, mode_reports: of ROS.
        vec_rows, vec_time: which controller states have the Proprioceptor that they answer, and when it was sent [s].
    """

    def __init__(self, bag: Bag, robot: RobotDescription) -> None:
        """Read them.

        Raises:
            BagError: the bag lacks a topic, or no controller state answers a Proprioceptor.
        """
        recording = Recording(bag, robot)
        driven = all(recording.has(topic) for topic in _DRIVEN)
        told = (*_TOLD, *_DRIVEN) if driven else _TOLD
        bag.load(*(recorded(topic) for topic in told), *_ROS)
        self.robot = robot
        self.senses, self.motor = recording.series(PROPRIOCEPTOR), recording.series(MOTOR)
        self.setpoints, self.states = recording.series(JOINT_SETPOINTS), recording.series(MOTION_STATE)
        self.hdt_commands: Series | None = None
        self.hdt_states: Series | None = None
        if driven:
            self.hdt_commands, self.hdt_states = (recording.series(topic) for topic in _DRIVEN)
        self.references, self.vec, self.joint_states = bag[REFERENCE], bag[VEC], bag[JOINT_STATES]
        self.mode_commands, self.mode_reports = bag[MODE_COMMAND], bag[MODE_REPORT]
        self.measured = recording.joints(PROPRIOCEPTOR, "joint_position")
        self.commanded = recording.joints(MOTOR, "position")
        self.vec_rows, self.vec_time = self.when_sensed(header_time(self.vec))
        if not len(self.vec_rows):
            raise BagError(f"{bag.path}: {VEC} and Proprioceptor have no robot time in common")

    def when_sensed(self, robot_time: FloatArray) -> tuple[Indices, FloatArray]:
        """Of messages that name a robot time [ns]: which have a Proprioceptor, and when that was sent [s]."""
        rows, place = named(robot_time, self.senses["time"])
        return rows, self.senses.sent[place]

    def motions(self) -> Iterator[Motion]:
        """All that were asked for."""
        robot_time, sent = self.senses.time, self.senses.sent
        for asked, message in zip(self.references.sent.tolist(), self.references.messages, strict=True):
            last = message.points[-1].time_from_start
            end = np.interp(asked, sent, robot_time) + last.sec + 1e-9 * last.nanosec
            yield Motion(asked, float(np.interp(end, robot_time, sent)), frozenset(message.joint_names))

    def driven(self) -> tuple[FloatArray, FloatArray, list[int]]:
        """What left for the plant: when [s], positions [rad] as the Motion System counts them, and of which joints.

        It is HdtCommand, or, where there is no driver, the Motor that is in force at each Proprioceptor.
        """
        if self.hdt_commands is not None:
            joints, offset = self.arm
            return self.hdt_commands.sent, self.hdt_commands["position"] - offset, joints
        in_force = np.searchsorted(self.motor["sequence"], self.senses["motor_sequence"])
        rows = in_force.clip(max=len(self.motor) - 1)
        return self.senses.sent, self.commanded[rows], list(range(len(self.robot.joints)))

    @property
    def arm(self) -> tuple[list[int], FloatArray]:
        """Places of the arm's joints, and the calibrated offsets [rad] of its encoders."""
        tables = self.robot.tables
        names = tables.group(ARM)
        offset = np.array([tables.calibration.offsets.get(name, 0.0) for name in names])
        return [self.robot.index[name] for name in names], offset


def header_time(series: Series) -> FloatArray:
    """(n,) robot time of messages by their headers [ns]."""
    made: FloatArray = 1e9 * series["header.stamp.sec"] + series["header.stamp.nanosec"]
    return made


def named(names: FloatArray, known: FloatArray) -> tuple[Indices, Indices]:
    """Of messages that name another: which name one that is known, and the first that has that name."""
    each, first = np.unique(known, return_index=True)
    place = np.searchsorted(each, names).clip(max=len(each) - 1)
    rows = np.flatnonzero(each[place] == names)
    return rows, first[place[rows]]
