"""An observer outside of a live system, that hears what it says.

The simulator's truth is for the record alone: the true way.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

import bifrost
from valor.analysis.track_builder import TrackBuilder
from valor.analysis.walk import Track
from valor.common.errors import ValorError
from valor.common.messages import ClockStatus, GroundTruth, MotionState, Statistics
from valor.common.rotation import heading
from valor.common.topics import CLOCK, GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR, STATISTICS
from valor.robot.description import RobotDescription

SILENCE = 10.0  # of the Motion Manager, after which a run is given up [s]


class Observer:
    """Hears what one run says.

    Attributes:
        state: the Motion Manager's newest.
    """

    state: MotionState

    def __init__(self, node: bifrost.Node, robot: RobotDescription, tell: Callable[[str], None]) -> None:
        self._states = MOTION_STATE.subscriber(node, queue=20000)
        self._measured = PROPRIOCEPTOR.subscriber(node, queue=20000)
        self._truths = GROUND_TRUTH.subscriber(node, queue=20000)
        self._clock = CLOCK.subscriber(node, queue=1000)
        self._statistics = STATISTICS["motion_manager"].subscriber(node, queue=1000)
        self._tell = tell
        self._track = TrackBuilder(robot)
        self._truth: list[GroundTruth] = []  # first and last
        self._clocks: list[ClockStatus] = []
        self._fares: list[Statistics] = []
        self._heard = time.monotonic()
        while not hasattr(self, "state"):
            self.hear()
            time.sleep(0.01)

    def hear(self) -> None:
        """Take in what has come.

        Raises:
            ValorError: nothing comes any more.
        """
        came = [received.message for received in self._states.drain()]
        self._track.add(came, [received.message for received in self._measured.drain()])
        self._clocks += [received.message for received in self._clock.drain()]
        self._fares += [received.message for received in self._statistics.drain()]
        for received in self._truths.drain():
            self._truth[1:] = [received.message]
        if came:
            self._heard = time.monotonic()
            self.state = came[-1]
            place = self._truth[-1].pelvis_position_in_world if self._truth else self.state.pelvis_position_in_odom
            self._tell(f"{1e-9 * self.state.time:.0f} s, {place[0]:.1f}, {place[1]:.1f} m, {self.state.behavior}")
        elif time.monotonic() - self._heard > SILENCE:
            raise ValorError(f"{MOTION_STATE.name} is silent for {SILENCE:g} s")

    def wait(self, over: Callable[[MotionState], bool], longest: float) -> bool:
        """Listen until a state says so; whether one did within ``longest`` of robot time [s]."""
        until = self.state.time + round(longest * 1e9)
        while not over(self.state):
            if self.state.time > until:
                return False
            time.sleep(0.01)
            self.hear()
        return True

    def track(self) -> Track:
        """All that was heard.

        Raises:
            ValorError: no state came with the measurement that it answers.
        """
        track = self._track.track()
        if track is None:
            raise ValorError(f"no {MOTION_STATE.name} with its {PROPRIOCEPTOR.name} was heard")
        return track

    @property
    def lost(self) -> int:
        """Messages that this observer missed."""
        return self._states.drops + self._measured.drops

    def timeliness(self) -> dict[str, float]:
        """Deadlines missed, waits timed out, slip [s], real-time factor; from the first word heard to the last."""
        figures = {"overruns": 0.0, "waits_timed_out": 0.0, "slip": 0.0, "real_time_factor": math.nan}
        if self._fares:
            figures["overruns"] = self._fares[-1].overruns - self._fares[0].overruns
        if self._clocks:
            first, last = self._clocks[0], self._clocks[-1]
            figures["waits_timed_out"] = last.waits_timed_out - first.waits_timed_out
            figures["slip"] = last.slip - first.slip
            figures["real_time_factor"] = float(np.mean([each.real_time_factor for each in self._clocks]))
        return figures

    def way(self) -> tuple[float, float, float]:
        """The true way of the pelvis: forward, left [m], turned [rad]."""
        first, last = self._truth[0], self._truth[-1]
        x, y = (last.pelvis_position_in_world - first.pelvis_position_in_world)[:2].tolist()
        turned = heading(last.pelvis_orientation_in_world.tolist()) - heading(
            first.pelvis_orientation_in_world.tolist()
        )
        return x, y, math.remainder(turned, 2.0 * math.pi)
