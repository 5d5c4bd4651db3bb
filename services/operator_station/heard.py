"""What the robot says of itself over ROS 2, as far as the page shows it: the newest values, with their ages."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.poses import Pose
from valor.operator_station.ages import Ages
from valor.operator_station.link import Link
from valor.operator_station.modes import Mode
from valor.operator_station.timeline import Timeline

NEWS = 40  # texts that are kept


@dataclass
class Heard:
    """The newest of everything.

    Attributes:
        ages: of each, by the attribute's name.
        time: robot time [s].
        joints: name → position [rad].
        velocities: name → velocity [rad/s].
        efforts: name → effort [N·m].
        pelvis: in odom.
        fixtures: (k,) of the simulated world's joints, in its order [rad]; (0,): not known.
        commanded: (n,) joint positions [rad], in the robot's order; (0,): not known.
        points: com, dcm, dcm_reference, cop → (3,) in odom [m].
        wrenches: l_foot, r_foot, … → (6,) force [N] and torque [N·m] of the world on the robot, in the sole or hand.
        contacts: of the left and the right foot.
        states: behavior, locomotion, manipulation, attention, reason.
        numbers: of MotionState: tick_time [s], motor_time [s], qp_failures, torque_saturations.
        mode: the control mode.
        steps: the plan that runs: index, foot and sole in odom of each step.
        executing: the step under way; −1: none.
        hands: state, reason and position error [m] of each hand's goal.
        status: robot_status: level and text.
        diagnostics: name → level and text.
        news: refusals and external changes, the newest first: when (wall clock) and text.
        modes: when which control mode was.
        link: what the link between robot and operator says of itself; None: there is none, or it is silent.
        picture: of the robot's view, compressed; empty: none has come over the link.
        transits: topic → from its last message's publication to its reception here, by both wall clocks [s].
    """

    ages: Ages = field(default_factory=Ages)
    time: float = 0.0
    joints: dict[str, float] = field(default_factory=dict)
    velocities: dict[str, float] = field(default_factory=dict)
    efforts: dict[str, float] = field(default_factory=dict)
    pelvis: Pose = field(default_factory=Pose)
    fixtures: FloatArray = field(default_factory=lambda: np.zeros(0))
    commanded: FloatArray = field(default_factory=lambda: np.zeros(0))
    points: dict[str, FloatArray] = field(default_factory=dict)
    wrenches: dict[str, FloatArray] = field(default_factory=dict)
    contacts: list[bool] = field(default_factory=lambda: [True, True])
    states: dict[str, str] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)
    mode: Mode = field(default_factory=Mode)
    steps: list[tuple[int, int, Pose]] = field(default_factory=list)
    executing: int = -1
    hands: dict[str, tuple[str, str, float]] = field(default_factory=dict)
    status: tuple[int, str] = (0, "")
    diagnostics: dict[str, tuple[int, str]] = field(default_factory=dict)
    news: deque[tuple[float, str]] = field(default_factory=lambda: deque(maxlen=NEWS))
    modes: Timeline = field(default_factory=Timeline)
    transits: dict[str, float] = field(default_factory=dict)

    link: Link | None = None
    picture: bytes = b""

    def forget(self) -> None:
        """As if nothing had been heard."""
        for name, value in vars(Heard()).items():
            setattr(self, name, value)

    def tell(self, when: float, text: str) -> None:
        """Something that whoever looks should read."""
        if not self.news or self.news[0][1] != text:
            self.news.appendleft((when, text))
