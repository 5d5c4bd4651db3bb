"""How well the robot's streams arrive at a ROS 2 node: rate and age of /joint_states, pace of /clock."""

from __future__ import annotations

import time
from collections import deque

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState


class Streams:
    """What a node has heard of both since it began to listen; times in seconds.

    Attributes:
        states: the newest joint states.
        clock: robot time as told last; None: not yet.
    """

    def __init__(self, node: Node) -> None:
        self.states: deque[JointState] = deque(maxlen=1000)
        self.clock: float | None = None
        self._states: list[tuple[float, float]] = []  # when each came, by the wall, and its stamp
        self._clocks: list[tuple[float, float]] = []  # likewise
        self._ages: list[float] = []  # of the newest state whenever /clock came
        node.create_subscription(JointState, "joint_states", self._hear_state, qos_profile_sensor_data)
        node.create_subscription(Clock, "clock", self._hear_clock, qos_profile_sensor_data)

    def _hear_state(self, state: JointState) -> None:
        self.states.append(state)
        self._states.append((time.monotonic(), seconds(state.header.stamp)))

    def _hear_clock(self, clock: Clock) -> None:
        self.clock = seconds(clock.clock)
        self._clocks.append((time.monotonic(), self.clock))
        if self._states:
            self._ages.append(self.clock - self._states[-1][1])

    def measured(self) -> dict[str, float | None]:
        """Rates [Hz], ages [ms], robot time to the wall's; None: not heard."""
        wall, robot = spans(self._states)
        clock_wall, clock_robot = spans(self._clocks)
        periods, ages = len(self._states) - 1, sorted(self._ages)
        return {
            "joint_states_rate": periods / wall if wall else None,  # by the wall's clock
            "joint_states_rate_robot": periods / robot if robot else None,  # by the robot's
            "joint_states_age_median": 1e3 * ages[len(ages) // 2] if ages else None,
            "joint_states_age_p99": 1e3 * ages[int(0.99 * len(ages))] if ages else None,
            "real_time_factor": clock_robot / clock_wall if clock_wall else None,
        }


def seconds(stamp: Time) -> float:
    """A stamp in seconds."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def spans(times: list[tuple[float, float]]) -> tuple[float, float]:
    """From the first to the last, by both clocks."""
    return (times[-1][0] - times[0][0], times[-1][1] - times[0][1]) if times else (0.0, 0.0)


def lines(measured: dict[str, float | None]) -> list[str]:
    """For people."""

    def number(key: str, digits: int, unit: str) -> str:
        value = measured[key]
        return "not heard" if value is None else f"{value:.{digits}f} {unit}".rstrip()

    wall_rate, robot_rate = number("joint_states_rate", 1, "Hz"), number("joint_states_rate_robot", 1, "Hz")
    median, p99 = number("joint_states_age_median", 1, "ms"), number("joint_states_age_p99", 1, "ms")
    return [
        f"joint_states      {wall_rate}, by robot time {robot_rate}",
        f"  behind /clock   median {median}, p99 {p99}",
        f"real-time factor  {number('real_time_factor', 3, '')}",
    ]
