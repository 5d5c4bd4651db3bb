"""Joint trajectory controller, as ros2_controllers' ``joint_trajectory_controller`` (Jazzy). Without input and output.

Goals and cancellations are queued by the ROS thread and executed in order in the update thread. An active controller
always has a set-point. It writes it only while the Motion System accepts set-points for its joints; otherwise the
controller and its trajectory wait.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Sequence
from typing import Self

import numpy as np

from valor.common.arrays import FloatArray
from valor.valor_ros_controller.controller_manager import Controller, Resources
from valor.valor_ros_controller.controllers.configuration import Settings, TrajectoryControllerConfig
from valor.valor_ros_controller.controllers.trajectory_goal import TrajectoryGoal, TrajectoryOutcome, TrajectoryRequest
from valor.valor_ros_controller.rejection_log import BoundedLog, RejectionLog
from valor.valor_ros_controller.trajectory.admission import begin
from valor.valor_ros_controller.trajectory.execution import Trajectory
from valor.valor_ros_controller.trajectory.waypoints import ErrorCode, InvalidTrajectoryError
from valor.valor_ros_controller.valor_escher_hw_interface import HAND_GOAL, ValorEscherHWInterface

_log = logging.getLogger("joint_trajectory_controller")

MOVED = 0.02  # largest motion by the Motion System during a wait for which the trajectory continues [rad or m]
LONGEST_WAIT = 1.0  # for acceptance of the joints, as between two behaviors [s]


class JointTrajectoryController(Controller):
    """Set-points of one limb.

    Attributes:
        joints: (n,) indices of its joints in the hardware interface's vectors.
        settings: replaced when a parameter changes, from any thread.
        position, velocity, acceleration: (n,) set-point [rad or m, 1/s, 1/s²].
        writing: active, and the Motion System accepts its joints.
        rejections: of trajectories.
    """

    type = "joint_trajectory_controller/JointTrajectoryController"
    config = TrajectoryControllerConfig
    command_interfaces = ("position", "velocity", "acceleration")

    def __init__(
        self, name: str, config: TrajectoryControllerConfig, hw: ValorEscherHWInterface, modes: Sequence[str]
    ) -> None:
        """``modes``: in which it is active, for texts of rejections."""
        self.name = name
        self.joints = hw.group_indices(config.groups)
        self.limits = hw.limits(self.joints)
        n = len(self.joints)
        self.settings = Settings.of(config.parameters(self.limits.names), self.limits.names)
        self._path = self.settings.path.position  # the default; a goal may state a tighter tolerance
        self._state = np.zeros((3, n))
        self._state_time = 0  # robot time of the set-point [ns]
        self.position, self.velocity, self.acceleration = self._state
        self.writing = False
        self._log = BoundedLog(_log)
        self.rejections = RejectionLog(self._log, "trajectory of {}")
        self._modes = ", ".join(modes)
        self._groups = config.groups
        self._accepted_when = tuple(config.accepted_when.items())
        self._queue: deque[TrajectoryRequest | TrajectoryGoal] = deque()
        self._trajectory = Trajectory.holding(0, self.position)
        self._request: TrajectoryRequest | None = None
        self._moving = False
        self._waiting_since = 0
        self._feedback = Schedule()

    @classmethod
    def make(cls, name: str, config: TrajectoryControllerConfig, resources: Resources) -> Self:
        return cls(name, config, resources.hw, resources.modes.running(name))

    # --- from any thread ------------------------------------------------------------------------------------------

    def submit(self, request: TrajectoryRequest) -> None:
        """Queue a trajectory; it replaces the current one."""
        self._queue.append(request)

    def cancel(self, goal: TrajectoryGoal) -> None:
        """Decelerate to rest if the goal is still active."""
        self._queue.append(goal)

    def reject(self, goal: TrajectoryGoal | None, error: InvalidTrajectoryError) -> None:
        """Reject a trajectory; the current one continues."""
        self.rejections.add(self.name, str(error), answered=goal is not None)
        if goal:
            goal.finish(TrajectoryOutcome(error.code, str(error)))

    # --- update thread --------------------------------------------------------------------------------------------

    def start(self, hw: ValorEscherHWInterface) -> None:
        """Activate and hold the Motion System's set-point."""
        hw.claim(self.name, self.joints)
        self.active = True
        self.writing = False
        self._waiting_since = hw.time
        self._hold_motion_system(hw)

    def stop(self, hw: ValorEscherHWInterface, reason: str) -> None:
        """Deactivate, release the joints and abort the active goal and those waiting for this cycle."""
        self.active = self.writing = False
        hw.release(self.name)
        text = f"Current goal cancelled during deactivate transition: {self.name} was deactivated: {reason}"
        self._end(TrajectoryOutcome(ErrorCode.INVALID_GOAL, text))
        while self._queue:
            entry = self._queue.popleft()
            if isinstance(entry, TrajectoryRequest):
                self.reject(entry.goal, InvalidTrajectoryError(text))

    def update(self, hw: ValorEscherHWInterface) -> None:
        """Execute queued requests, then write the set-point of this cycle."""
        if self.active:
            self._accept(hw)
        while self._queue:
            entry = self._queue.popleft()
            if isinstance(entry, TrajectoryRequest):
                self._take_up(entry, hw)
            elif self._request and self._request.goal is entry:
                self._come_to_rest(hw)
                self._end(TrajectoryOutcome(ErrorCode.SUCCESSFUL, "canceled: holding", canceled=True))
        if not self.writing:
            return
        if self._moving:
            self._trajectory.sample(hw.time, self._state)
            self._moving = hw.time < self._trajectory.end
            hw.command[:, self.joints] = self._state
        self._state_time = hw.time
        if self._request:
            self._monitor(self._request, hw)

    @property
    def trajectory_start(self) -> int:
        """Robot time at ``time_from_start`` 0 [ns]: as stamped, or the start of execution."""
        return (self._request.start if self._request else 0) or self._trajectory.start

    def state_at(self, time: int) -> tuple[str, FloatArray]:
        """Set-point at a robot time [ns], for the service ``query_state``.

        Returns:
            Error (also for a time after the end), else empty; (3, n) position, velocity, acceleration, or (3, 0).
        """
        trajectory, message = self._trajectory, ""
        if not self.active:
            return f"{self.name} is not active", np.zeros((3, 0))
        if time < trajectory.start:
            message = f"{(trajectory.start - time) * 1e-9:.3f} s before the trajectory begins"
        elif time > trajectory.end:
            message = f"{(time - trajectory.end) * 1e-9:.3f} s after the trajectory has ended, where it holds"
        return message, trajectory.at(time)

    def _accept(self, hw: ValorEscherHWInterface) -> None:
        """Check whether the Motion System accepts the joints; wait while it does not."""
        motion = hw.motion
        accepted = motion is not None and not self._taken(hw)
        for field, state in self._accepted_when:
            accepted = accepted and getattr(motion, field) == state
        if not accepted:
            if self.writing:
                self.writing, self._waiting_since = False, hw.time
                hw.pause(self.name)
            if self._request:
                self._wait(self._request, hw)
            return
        if self.writing:
            return
        self.writing, self._state_time = True, hw.time
        self._trajectory.delay(hw.time - self._waiting_since)
        moved = np.abs(hw.held(self.joints) - self.position)
        if self._request is None:
            self._hold_motion_system(hw)
        elif moved.max() > MOVED:
            joint = int(np.argmax(moved))
            name, unit = self.limits.names[joint], self.limits.units[joint]
            self._hold_motion_system(hw)
            text = f"aborted: the Motion System moved {name} by {moved[joint]:.3f} {unit} during the wait"
            self._end(TrajectoryOutcome(ErrorCode.INVALID_GOAL, text))
        hw.command[:, self.joints] = self._state
        hw.write(self.name, self.joints)

    def _wait(self, request: TrajectoryRequest, hw: ValorEscherHWInterface) -> None:
        """Wait while the Motion System does not accept the joints; abort when they are lost."""
        waited = (hw.time - self._waiting_since) * 1e-9
        lost = self._taken(hw)
        if not lost and waited > LONGEST_WAIT:
            lost = f"the Motion System has accepted no set-points for {waited:.1f} s; {self._expected(hw)}"
        if lost:
            self._hold_motion_system(hw)
            self._end(TrajectoryOutcome(ErrorCode.INVALID_GOAL, f"aborted: {lost}"))
        elif request.goal and self._feedback_due(hw):
            request.goal.feedback(hw)

    def _taken(self, hw: ValorEscherHWInterface) -> str:
        """Reason that the joints are frozen, or a hand goal controls them; empty if neither."""
        if frozen := [group for group in self._groups if group in hw.frozen]:
            return f"{frozen[0]} is frozen"
        taken = [limb for limb, _ in self._accepted_when if hw.motion and getattr(hw.motion, limb) == HAND_GOAL]
        return f"the {taken[0].replace('_', ' ')} follows a hand goal, until that is canceled" if taken else ""

    def _expected(self, hw: ValorEscherHWInterface) -> str:
        """States in which the Motion System accepts the joints."""
        expected = ", ".join(f"{machine} {state}" for machine, state in self._accepted_when)
        return f"it is in behavior {hw.motion.behavior if hw.motion else 'unknown'}; expected {expected}"

    def _feedback_due(self, hw: ValorEscherHWInterface) -> bool:
        return self._feedback.due(hw.time, round(1e9 / self.settings.action_monitor_rate))

    def _hold_motion_system(self, hw: ValorEscherHWInterface) -> None:
        """Set the set-point to the Motion System's."""
        self.position[:] = self.limits.position_within(hw.held(self.joints))
        self._state[1:] = 0.0
        self._state_time = hw.time
        self._trajectory = Trajectory.holding(hw.time, self.position)
        self._moving = False

    def _take_up(self, request: TrajectoryRequest, hw: ValorEscherHWInterface) -> None:
        """Replace the current trajectory if the new one can begin from the set-point."""
        try:
            if not self.active:
                raise InvalidTrajectoryError(
                    f"{self.name} is not active: {hw.situation}; it is active in the control modes "
                    f"{self._modes}, unless a client has deactivated it",
                )
            if not self.writing:
                rejected = f"the Motion System accepts no set-points for {self.name}; {self._expected(hw)}"
                raise InvalidTrajectoryError(self._taken(hw) or rejected)
            trajectory = begin(
                request.waypoints,
                request.start,
                hw.time,
                self._state,
                self.limits,
                since=self._state_time,
                error=np.maximum(self._path, request.path.position),
                late=request.late,
            )
            if (ending := request.waypoints.states[1, -1]).any():
                velocity = np.zeros(len(self.joints))
                velocity[request.waypoints.columns] = ending
                trajectory = trajectory.then_resting(velocity, self.settings.max_deceleration, self.limits)
        except InvalidTrajectoryError as error:
            self.reject(request.goal, error)
            return
        if self._request and self._request.goal:  # no client waits for one of a stream
            self._end(TrajectoryOutcome(ErrorCode.INVALID_GOAL, "Current goal preempted by new incoming action"))
        self._trajectory, self._request, self._moving = trajectory, request, True
        self._feedback.begin(hw.time)

    def _monitor(self, request: TrajectoryRequest, hw: ValorEscherHWInterface) -> None:
        """Check tolerances against the measured state."""
        position_error = self.position - hw.position[self.joints]
        velocity_error = self.velocity - hw.velocity[self.joints]
        late = (hw.time - self._trajectory.end) * 1e-9
        if outcome := request.judge(self.limits, late, position_error, velocity_error):
            if outcome.code is ErrorCode.PATH_TOLERANCE_VIOLATED:
                self._come_to_rest(hw)
            self._end(outcome)
        elif request.goal and self._feedback_due(hw):
            request.goal.feedback(hw)

    def _come_to_rest(self, hw: ValorEscherHWInterface) -> None:
        """Decelerate from the commanded motion, or stop at once; then hold."""
        settings = self.settings
        if settings.decelerate_on_cancel:
            self._trajectory = Trajectory.stopping(
                self._state_time, self.position, self.velocity, settings.max_deceleration, self.limits
            )
        else:
            self._trajectory = Trajectory.holding(hw.time, self.position)
        self._moving = True

    def _end(self, outcome: TrajectoryOutcome) -> None:
        """End the request with an outcome."""
        request, self._request = self._request, None
        if request is None:
            return
        failed = not outcome.canceled and outcome.code is not ErrorCode.SUCCESSFUL
        if request.goal:
            request.goal.finish(outcome)
        elif failed:
            self.rejections.publish(outcome.text)
        if failed:
            self._log.warning(f"{self.name}: {outcome.text}")


class Schedule:
    """Periodic events on robot time: a period after the last due time, not after the event."""

    def __init__(self) -> None:
        self._next = 0

    def begin(self, time: int) -> None:
        """Make the event due at a robot time [ns]."""
        self._next = time

    def due(self, time: int, period: int) -> bool:
        """Whether the event is due at a robot time; if so, the next is due a period later [ns].

        If time went back, or on by more than a period, the schedule restarts.
        """
        if self._next - period <= time < self._next:
            return False
        self._next = (self._next if self._next <= time < self._next + period else time) + period
        return True
