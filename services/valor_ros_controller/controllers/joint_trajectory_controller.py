"""Runs joint trajectories, as ros2_controllers' ``joint_trajectory_controller`` (Jazzy) does.

Goals and cancellations come through a queue from the ROS thread and are obeyed in the update thread, in order; none is
lost. An active controller always has a set-point, so a joint is never left to itself. It writes it only while the
Motion System accepts set-points for its joints; otherwise it waits, and so does its trajectory.

No input or output here: who asked is behind the ``Goal`` protocol.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Protocol

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from valor_common.robot import RobotDescription
from valor_ros_controller.control_modes import load_table
from valor_ros_controller.trajectory import (
    ErrorCode,
    InvalidTrajectoryError,
    JointLimits,
    Trajectory,
    Waypoints,
)
from valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

_log = logging.getLogger("joint_trajectory_controller")

Vector = npt.NDArray[np.float64]
FILE = Path(__file__).parent.parent / "controllers.yaml"

MOVED = 0.02
"""A controller that waited goes on only if the Motion System moved none of its joints farther than this [rad]."""

_NonNegative = Annotated[float, Field(ge=0)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Constraints(_Table):
    """Default tolerances; 0: not checked."""

    stopped_velocity_tolerance: _NonNegative  # at the goal [rad/s]
    goal_time: _NonNegative  # how late the goal may be reached [s]; 0: however late
    trajectory: _NonNegative  # on the way [rad]
    goal: _NonNegative  # [rad]


class ControllerConfig(_Table):
    """One controller of ``controllers.yaml``, where the keys are explained."""

    groups: tuple[str, ...]
    accepted_when: dict[str, str]
    allow_partial_joints_goal: bool
    action_monitor_rate: Annotated[float, Field(gt=0)]
    max_deceleration_on_cancel: Annotated[float, Field(gt=0)]
    constraints: Constraints


class ControllersTable(_Table):
    """``controllers.yaml``."""

    namespace: str
    defaults: dict[str, object]  # named only to be referred to within the file
    controllers: dict[str, ControllerConfig]

    @classmethod
    def load(cls, file: Path = FILE) -> ControllersTable:
        """Read the table.

        Raises:
            ConfigurationError: the file or a key is missing or wrong.
        """
        return load_table(cls, file)


@dataclass(frozen=True)
class Tolerances:
    """How far from the desired state each of n joints may be; inf: not checked."""

    position: Vector  # (n,) [rad]
    velocity: Vector  # (n,) [rad/s]

    @classmethod
    def default(cls, n: int, position: float, velocity: float) -> Tolerances:
        """The same for every joint; 0: not checked."""
        return cls(np.full(n, position or np.inf), np.full(n, velocity or np.inf))

    def override(self, entries: Sequence[tuple[str, float, float]], names: Sequence[str], which: str) -> Tolerances:
        """Take what a goal states: (joint, position, velocity); 0: keep the default, -1: not checked.

        Raises:
            InvalidTrajectoryError: an unknown joint, or a number that is none of these.
        """
        position, velocity = self.position.copy(), self.velocity.copy()
        for name, *values in entries:
            if name not in names:
                raise InvalidTrajectoryError(
                    ErrorCode.INVALID_GOAL, f"{which} names {name!r}, which is none of {', '.join(names)}"
                )
            joint = names.index(name)
            for field, target, value in zip(("position", "velocity"), (position, velocity), values, strict=True):
                if not np.isfinite(value) or (value < 0 and value != -1):
                    raise InvalidTrajectoryError(
                        ErrorCode.INVALID_GOAL,
                        f"{which} of {name}: {field} is {value:g}; expected positive, 0 (default) or -1 (unchecked)",
                    )
                if value:
                    target[joint] = np.inf if value < 0 else value
        return Tolerances(position, velocity)

    def violation(self, names: Sequence[str], position_error: Vector, velocity_error: Vector) -> str:
        """Which joint is out, by how much, and the limit; empty: none."""
        if (np.abs(position_error) > self.position).any():
            joint = int(np.argmax(np.abs(position_error) / self.position))
            return f"{names[joint]} is {position_error[joint]:+.3f} rad off; tolerance {self.position[joint]:g} rad"
        if (np.abs(velocity_error) > self.velocity).any():
            joint = int(np.argmax(np.abs(velocity_error) / self.velocity))
            return f"{names[joint]} is {velocity_error[joint]:+.3f} rad/s off; tolerance {self.velocity[joint]:g} rad/s"
        return ""


@dataclass(frozen=True)
class Outcome:
    """What became of a goal."""

    code: ErrorCode
    text: str
    canceled: bool = False


class Goal(Protocol):
    """Somebody who waits for a trajectory to end."""

    def finish(self, outcome: Outcome) -> None:
        """It has ended."""

    def feedback(self, controller: JointTrajectoryController, hw: ValorEscherHWInterface) -> None:
        """It goes on."""


@dataclass(frozen=True)
class TrajectoryRequest:
    """A checked trajectory; ``goal`` is ``None`` where nobody waits for its end."""

    waypoints: Waypoints
    start: int  # robot time [ns]; 0: when it is taken up
    path: Tolerances
    goal_tolerance: Tolerances
    goal_time: float  # [s]; 0: however late
    goal: Goal | None


class JointTrajectoryController:
    """One limb's set-points.

    Attributes:
        joints: (n,) places of its joints in the robot's vectors.
        position, velocity, acceleration: (n,) the set-point.
        active: chosen by the control mode.
        writing: active, and the Motion System accepts its joints.
        last_refusal: of a trajectory, with its reason; for people.
        rejected: how many trajectories were refused.
    """

    def __init__(self, name: str, config: ControllerConfig, robot: RobotDescription, modes: Sequence[str]) -> None:
        """Make the controller, inactive.

        Args:
            name: in ROS names.
            config: from controllers.yaml.
            robot: whose joints.
            modes: in which it is active, for the text of a refusal.
        """
        self._name = name
        self.config = config
        self.joints = np.concatenate([robot.group_indices(group) for group in config.groups])
        self.limits = JointLimits(
            tuple(robot.joints[i] for i in self.joints),
            robot.lower[self.joints],
            robot.upper[self.joints],
            robot.velocity_limit[self.joints],
        )
        n = len(self.joints)
        self.position, self.velocity, self.acceleration = np.zeros(n), np.zeros(n), np.zeros(n)
        self.active = False
        self.writing = False
        self.last_refusal = ""
        self.rejected = 0
        self.path = Tolerances.default(n, config.constraints.trajectory, 0.0)
        self.goal_tolerance = Tolerances.default(
            n, config.constraints.goal, config.constraints.stopped_velocity_tolerance
        )
        self._modes = ", ".join(modes)
        self._accepted_when = tuple(config.accepted_when.items())
        self._queue: deque[TrajectoryRequest | Goal] = deque()
        self._trajectory = Trajectory.holding(0, self.position)
        self._request: TrajectoryRequest | None = None
        self._moving = False
        self._waiting_since = 0
        self._feedback_period = round(1e9 / config.action_monitor_rate)
        self._next_feedback = 0

    @property
    def name(self) -> str:
        """In ROS names."""
        return self._name

    # --- from any thread ------------------------------------------------------------------------------------------

    def submit(self, request: TrajectoryRequest) -> None:
        """Run a trajectory; replaces the one that runs."""
        self._queue.append(request)

    def cancel(self, goal: Goal) -> None:
        """Come to rest, if the goal is still the one that runs."""
        self._queue.append(goal)

    def refuse(self, goal: Goal | None, error: InvalidTrajectoryError) -> None:
        """Say why a trajectory is not run. Nothing moves, and what runs goes on."""
        self.rejected += 1
        self.last_refusal = f"{self._name}: {error}"
        _log.warning("%s: trajectory refused: %s", self._name, error)
        if goal:
            goal.finish(Outcome(error.code, str(error)))

    # --- update thread --------------------------------------------------------------------------------------------

    def start(self, hw: ValorEscherHWInterface) -> None:
        """Hold what the Motion System commands now."""
        hw.claim(self._name, self.joints)
        self.active = True
        self.writing = False
        self._waiting_since = hw.time
        self._hold_motion_system(hw)

    def stop(self, hw: ValorEscherHWInterface, reason: str) -> None:
        """Give the joints back; a goal in progress is aborted."""
        self.active = self.writing = False
        hw.release(self._name)
        self._end(Outcome(ErrorCode.INVALID_GOAL, f"aborted: {self._name} was deactivated: {reason}"))

    def update(self, hw: ValorEscherHWInterface) -> None:
        """Obey what came, then write the set-point of this cycle."""
        if self.active:
            self._accept(hw)
        while self._queue:
            entry = self._queue.popleft()
            if isinstance(entry, TrajectoryRequest):
                self._take_up(entry, hw)
            elif self._request and self._request.goal is entry:
                self._come_to_rest(hw)
                self._end(Outcome(ErrorCode.SUCCESSFUL, "canceled: holding", canceled=True))
        if not self.writing:
            return
        if self._moving:
            self._trajectory.sample(hw.time, self.position, self.velocity, self.acceleration)
            self._moving = hw.time < self._trajectory.end
        hw.command_position[self.joints] = self.position
        hw.command_velocity[self.joints] = self.velocity
        hw.command_acceleration[self.joints] = self.acceleration
        hw.write(self._name, self.joints)
        if self._request:
            self._monitor(self._request, hw)

    def _accept(self, hw: ValorEscherHWInterface) -> None:
        """Find out whether the Motion System accepts our joints, and wait while it does not."""
        motion = hw.motion
        accepted = motion is not None and all(getattr(motion, field) == state for field, state in self._accepted_when)
        if accepted == self.writing:
            return
        self.writing = accepted
        if not accepted:
            self._waiting_since = hw.time
            hw.pause(self._name)
            return
        self._trajectory.delay(hw.time - self._waiting_since)
        assert motion is not None
        moved = np.abs(motion.joint_setpoint[self.joints] - self.position)
        if moved.max() > MOVED:
            joint = int(np.argmax(moved))
            text = f"aborted: the Motion System moved {self.limits.names[joint]} by {moved[joint]:.3f} rad meanwhile"
            self._hold_motion_system(hw)
            self._end(Outcome(ErrorCode.INVALID_GOAL, text))

    def _hold_motion_system(self, hw: ValorEscherHWInterface) -> None:
        """Take for set-point what the Motion System commands."""
        assert hw.motion is not None
        self.position[:] = np.clip(hw.motion.joint_setpoint[self.joints], self.limits.lower, self.limits.upper)
        self.velocity.fill(0.0)
        self.acceleration.fill(0.0)
        self._trajectory = Trajectory.holding(hw.time, self.position)
        self._moving = False

    def _take_up(self, request: TrajectoryRequest, hw: ValorEscherHWInterface) -> None:
        """Replace what runs, if the new trajectory can begin from here."""
        try:
            if not self.active:
                raise InvalidTrajectoryError(
                    ErrorCode.INVALID_GOAL,
                    f"{self._name} is not active: {hw.situation}; it is active in the control modes {self._modes}",
                )
            if not self.writing:
                wanted = ", ".join(f"{field} {state}" for field, state in self._accepted_when)
                present = hw.motion.behavior if hw.motion else "unknown"
                raise InvalidTrajectoryError(
                    ErrorCode.INVALID_GOAL,
                    f"the Motion System accepts no set-points for {self._name} in behavior {present}; "
                    f"expected {wanted}",
                )
            trajectory = Trajectory.begin(
                request.waypoints,
                request.start,
                hw.time,
                (self.position, self.velocity, self.acceleration),
                self.limits,
            )
        except InvalidTrajectoryError as error:
            self.refuse(request.goal, error)
            return
        self._end(Outcome(ErrorCode.INVALID_GOAL, "preempted: replaced by a new trajectory"))
        self._trajectory, self._request, self._moving = trajectory, request, True
        self._next_feedback = hw.time

    def _monitor(self, request: TrajectoryRequest, hw: ValorEscherHWInterface) -> None:
        """Compare with the measured state: tolerances on the way and at the end."""
        position_error = self.position - hw.position[self.joints]
        velocity_error = self.velocity - hw.velocity[self.joints]
        names = self.limits.names
        if hw.time < self._trajectory.end:
            if violation := request.path.violation(names, position_error, velocity_error):
                self._come_to_rest(hw)
                self._end(Outcome(ErrorCode.PATH_TOLERANCE_VIOLATED, f"aborted on the way: {violation}"))
                return
        else:
            violation = request.goal_tolerance.violation(names, position_error, velocity_error)
            late = (hw.time - self._trajectory.end) * 1e-9
            if not violation:
                self._end(Outcome(ErrorCode.SUCCESSFUL, "goal reached"))
                return
            if request.goal_time and late > request.goal_time:
                text = f"not at the goal {request.goal_time:g} s after its time: {violation}"
                self._end(Outcome(ErrorCode.GOAL_TOLERANCE_VIOLATED, text))
                return
        if hw.time >= self._next_feedback and request.goal:
            self._next_feedback = hw.time + self._feedback_period
            request.goal.feedback(self, hw)

    def _come_to_rest(self, hw: ValorEscherHWInterface) -> None:
        """Decelerate from the motion commanded now, and hold."""
        self._trajectory = Trajectory.stopping(
            hw.time, self.position, self.velocity, self.config.max_deceleration_on_cancel, self.limits
        )
        self._moving = True

    def _end(self, outcome: Outcome) -> None:
        """Nobody waits for the trajectory any more."""
        request, self._request = self._request, None
        if request and request.goal:
            request.goal.finish(outcome)
        if request and not outcome.canceled and outcome.code is not ErrorCode.SUCCESSFUL:
            _log.warning("%s: %s", self._name, outcome.text)
