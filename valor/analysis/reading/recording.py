"""A bag of the robot: Bifrost topics by name, joints, behaviors, postures."""

from typing import Any

import numpy as np
import numpy.typing as npt

from valor.analysis.reading.bag import Bag, Series
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray
from valor.common.behaviors import MANIPULATING
from valor.common.topics import GROUND_TRUTH, JOINT_SETPOINTS, MOTION_STATE, MOTOR, PROPRIOCEPTOR, Topic
from valor.drawing import Posture
from valor.robot.description import RobotDescription


def recorded(topic: Topic[Any]) -> str:
    """ROS name of a Bifrost topic in a bag."""
    return f"/bifrost/{topic.name}"


class Recording:
    """A bag and the description of its robot."""

    def __init__(self, bag: Bag, robot: RobotDescription) -> None:
        self.bag = bag
        self.robot = robot

    @property
    def world(self) -> tuple[str, int]:
        """Name and seed of the simulated world; ``flat`` if the bag does not specify it."""
        origin = self.bag.origin
        return origin.get("world", "flat"), int(origin.get("seed", "0"))

    def series(self, topic: Topic[Any]) -> Series:
        """All messages of a Bifrost topic."""
        return self.bag[recorded(topic)]

    def has(self, topic: Topic[Any]) -> bool:
        """Return whether the bag has messages of a Bifrost topic."""
        return recorded(topic) in self.bag

    def load(self, *topics: Topic[Any]) -> None:
        """Read several topics in one pass."""
        self.bag.load(*(recorded(topic) for topic in topics))

    def joints(self, topic: Topic[Any], field: str) -> FloatArray:
        """(m, n) a field with one value per joint. Raises BagError: the bag's robot has another number of joints."""
        values = self.series(topic)[field]
        if values.ndim != 2 or values.shape[1] != len(self.robot.joints):
            width = values.shape[1] if values.ndim == 2 else 1
            raise BagError(
                f"{self.bag.path}: {recorded(topic)}: {width} joints in {field!r}; "
                f"robot {self.robot.name!r} has {len(self.robot.joints)}"
            )
        return values

    def behaviors(self, times: FloatArray) -> npt.NDArray[np.str_]:
        """Behavior of the Motion System at some robot times [s]."""
        states = self.series(MOTION_STATE)
        return states.strings("behavior")[nearest(states.time, times)]

    def manipulation(self) -> tuple[float, float] | None:
        """First and last time in a manipulation behavior [s]; None if there is none."""
        states = self.series(MOTION_STATE)
        free = np.flatnonzero(np.isin(states.strings("behavior"), [*MANIPULATING]))
        return (float(states.time[free[0]]), float(states.time[free[-1]])) if free.size else None

    def posture(self, time: float) -> Posture:
        """The robot at a time [s]: its true pose if the simulator reports it, else the estimated one."""
        states = self.series(MOTION_STATE)
        joints = self.series(PROPRIOCEPTOR)
        at = np.array([time])
        behavior = str(self.behaviors(at)[0])
        position = self.joints(PROPRIOCEPTOR, "joint_position")[nearest(joints.time, at)[0]]
        source, frame = (self.series(GROUND_TRUTH), "world") if self.has(GROUND_TRUTH) else (states, "odom")
        row = nearest(source.time, at)[0]
        return Posture(
            time=float(joints.time[nearest(joints.time, at)[0]]),
            behavior=behavior,
            pelvis_position=source[f"pelvis_position_in_{frame}"][row],
            pelvis_orientation=source[f"pelvis_orientation_in_{frame}"][row],
            joint_position=position,
            # Absent in older recordings.
            fixture_position=np.array(getattr(source.messages[row], "fixture_position", ()), dtype=float),
        )

    def setpoints(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Set-points of the ROS side by joint: times [s] and positions [rad]; empty if none were recorded."""
        return self.series(JOINT_SETPOINTS).by_joint("position") if self.has(JOINT_SETPOINTS) else {}

    def commands(self) -> tuple[FloatArray, FloatArray]:
        """Motor commands: times (m,) [s] and positions (m, n) [rad]."""
        return self.series(MOTOR).time, self.joints(MOTOR, "position")

    def measured(self) -> tuple[FloatArray, FloatArray]:
        """Measured joints: times (m,) [s] and positions (m, n) [rad]."""
        return self.series(PROPRIOCEPTOR).time, self.joints(PROPRIOCEPTOR, "joint_position")


def nearest(times: FloatArray, wanted: FloatArray) -> npt.NDArray[np.intp]:
    """Index of the nearest of ``times``, which ascend, for each wanted time."""
    right = np.clip(np.searchsorted(times, wanted), 1, max(1, len(times) - 1))
    left = right - 1
    right = np.minimum(right, len(times) - 1)
    return np.where(wanted - times[left] <= times[right] - wanted, left, right)
