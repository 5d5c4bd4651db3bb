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

import numpy as np

from valor.common.arrays import FloatArray
from valor.valor_ros_controller.controllers.configuration import Settings, TrajectoryControllerConfig
from valor.valor_ros_controller.controllers.trajectory_goal import Goal, Outcome, TrajectoryRequest
from valor.valor_ros_controller.refusals import BoundedLog, Refusals
from valor.valor_ros_controller.schedule import Schedule
from valor.valor_ros_controller.trajectory.admission import begin
from valor.valor_ros_controller.trajectory.errors import ErrorCode, InvalidTrajectoryError
from valor.valor_ros_controller.trajectory.execution import Trajectory
from valor.valor_ros_controller.valor_escher_hw_interface import HAND_GOAL, ValorEscherHWInterface

_log = logging.getLogger("joint_trajectory_controller")

MOVED = 0.02
"""A controller that waited goes on only if the Motion System moved none of its joints farther than this [rad or m]."""
LONGEST_WAIT = 1.0
"""So long a trajectory waits for the Motion System to accept its joints again, as between two behaviors [s]."""


class JointTrajectoryController:
    """One limb's set-points.

    Attributes:
        name: in ROS names.
        joints: (n,) places of its joints in the hardware interface's vectors.
        settings: replaced as a whole when a parameter changes, from any thread.
        position, velocity, acceleration: (n,) the set-point.
        active: chosen by the control mode.
        writing: active, and the Motion System accepts its joints.
        refusals: of trajectories.
    """

    type = "joint_trajectory_controller/JointTrajectoryController"
    command_interfaces = ("position", "velocity", "acceleration")

    def __init__(
        self, name: str, config: TrajectoryControllerConfig, hw: ValorEscherHWInterface, modes: Sequence[str]
    ) -> None:
        """Make the controller, inactive.

        Args:
            name: in ROS names.
            config: from controllers.yaml.
            hw: whose joints.
            modes: in which it is active, for the text of a refusal.
        """
        self.name = name
        self.joints = hw.group_indices(config.groups)
        self.limits = hw.limits(self.joints)
        n = len(self.joints)
        self.settings = Settings.of(config, n)
        self._path = self.settings.path.position  # who asks for a tighter one may try
        self._state = np.zeros((3, n))
        self.position, self.velocity, self.acceleration = self._state
        self.active = False
        self.writing = False
        self._log = BoundedLog(_log)
        self.refusals = Refusals(self._log, "trajectory of {}")
        self._modes = ", ".join(modes)
        self._accepted_when = tuple(config.accepted_when.items())
        self._queue: deque[TrajectoryRequest | Goal] = deque()
        self._trajectory = Trajectory.holding(0, self.position)
        self._request: TrajectoryRequest | None = None
        self._moving = False
        self._waiting_since = 0
        self._feedback = Schedule()

    # --- from any thread ------------------------------------------------------------------------------------------

    def submit(self, request: TrajectoryRequest) -> None:
        """Run a trajectory; replaces the one that runs."""
        self._queue.append(request)

    def cancel(self, goal: Goal) -> None:
        """Come to rest, if the goal is still the one that runs."""
        self._queue.append(goal)

    def refuse(self, goal: Goal | None, error: InvalidTrajectoryError) -> None:
        """Say why a trajectory is not run. Nothing moves, and what runs goes on."""
        self.refusals.add(self.name, str(error), answered=goal is not None)
        if goal:
            goal.finish(Outcome(error.code, str(error)))

    # --- update thread --------------------------------------------------------------------------------------------

    def start(self, hw: ValorEscherHWInterface) -> None:
        """Hold what the Motion System commands now."""
        hw.claim(self.name, self.joints)
        self.active = True
        self.writing = False
        self._waiting_since = hw.time
        self._hold_motion_system(hw)

    def stop(self, hw: ValorEscherHWInterface, reason: str) -> None:
        """Give the joints back; a goal in progress is aborted.

        So is one that has come and waits for this cycle: it was sent before, and who starts again is to hold.
        """
        self.active = self.writing = False
        hw.release(self.name)
        text = f"Current goal cancelled during deactivate transition: {self.name} was deactivated: {reason}"
        self._end(Outcome(ErrorCode.INVALID_GOAL, text))
        while self._queue:
            entry = self._queue.popleft()
            if isinstance(entry, TrajectoryRequest):
                self.refuse(entry.goal, InvalidTrajectoryError(text))

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
            self._trajectory.sample(hw.time, self._state)
            self._moving = hw.time < self._trajectory.end
            hw.command[:, self.joints] = self._state
        if self._request:
            self._monitor(self._request, hw)

    @property
    def trajectory_start(self) -> int:
        """Robot time that ``time_from_start`` counts from [ns]: as stamped, or when the trajectory was taken up."""
        return (self._request.start if self._request else 0) or self._trajectory.start

    def state_at(self, time: int) -> tuple[str, FloatArray]:
        """Where the set-point is, or will be, at a robot time [ns]: the service ``query_state``.

        After the end of the trajectory it is where the trajectory ended, but that is no success, as with the original.

        Returns:
            Why there is no answer, empty where there is one; (3, n) position, velocity and acceleration, or (3, 0).
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
        """Find out whether the Motion System accepts our joints, and wait while it does not."""
        motion = hw.motion
        accepted = motion is not None
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
        self.writing = True
        self._trajectory.delay(hw.time - self._waiting_since)
        moved = np.abs(hw.commanded[self.joints] - self.position)
        if self._request is None:
            self._hold_motion_system(hw)
        elif moved.max() > MOVED:
            joint = int(np.argmax(moved))
            name, unit = self.limits.names[joint], self.limits.units[joint]
            self._hold_motion_system(hw)
            text = f"aborted: the Motion System moved {name} by {moved[joint]:.3f} {unit} meanwhile"
            self._end(Outcome(ErrorCode.INVALID_GOAL, text))
        hw.command[:, self.joints] = self._state
        hw.write(self.name, self.joints)

    def _wait(self, request: TrajectoryRequest, hw: ValorEscherHWInterface) -> None:
        """The Motion System does not accept our joints: for a moment, or they are lost, and who asked is told."""
        waited = (hw.time - self._waiting_since) * 1e-9
        lost = self._leader(hw)
        if not lost and waited > LONGEST_WAIT:
            lost = f"the Motion System has accepted none of its set-points for {waited:.1f} s; {self._wanted(hw)}"
        if lost:
            self._hold_motion_system(hw)
            self._end(Outcome(ErrorCode.INVALID_GOAL, f"aborted: {lost}"))
        elif request.goal and self._feedback_due(hw):
            request.goal.feedback(hw)

    def _leader(self, hw: ValorEscherHWInterface) -> str:
        """Who has taken the joints, for people; empty: nobody."""
        taken = [limb for limb, _ in self._accepted_when if hw.motion and getattr(hw.motion, limb) == HAND_GOAL]
        return f"the {taken[0].replace('_', ' ')} follows a hand goal, until that is canceled" if taken else ""

    def _wanted(self, hw: ValorEscherHWInterface) -> str:
        """What the Motion System would have to be in."""
        wanted = ", ".join(f"{machine} {state}" for machine, state in self._accepted_when)
        return f"it is in behavior {hw.motion.behavior if hw.motion else 'unknown'}; expected {wanted}"

    def _feedback_due(self, hw: ValorEscherHWInterface) -> bool:
        return self._feedback.due(hw.time, round(1e9 / self.settings.action_monitor_rate))

    def _hold_motion_system(self, hw: ValorEscherHWInterface) -> None:
        """Take for set-point what the Motion System commands."""
        self.position[:] = self.limits.position_within(hw.commanded[self.joints])
        self._state[1:] = 0.0
        self._trajectory = Trajectory.holding(hw.time, self.position)
        self._moving = False

    def _take_up(self, request: TrajectoryRequest, hw: ValorEscherHWInterface) -> None:
        """Replace what runs, if the new trajectory can begin from here."""
        try:
            if not self.active:
                raise InvalidTrajectoryError(
                    f"{self.name} is not active: {hw.situation}; it is active in the control modes "
                    f"{self._modes}, unless a client has deactivated it",
                )
            if not self.writing:
                refused = f"the Motion System accepts no set-points for {self.name}; {self._wanted(hw)}"
                raise InvalidTrajectoryError(self._leader(hw) or refused)
            trajectory = begin(
                request.waypoints,
                request.start,
                hw.time,
                self._state,
                self.limits,
                error=np.maximum(self._path, request.path.position),
                late=request.late,
            )
            if (ending := request.waypoints.states[1, -1]).any():
                velocity = np.zeros(len(self.joints))
                velocity[request.waypoints.columns] = ending
                trajectory = trajectory.then_resting(velocity, self.settings.max_deceleration, self.limits)
        except InvalidTrajectoryError as error:
            self.refuse(request.goal, error)
            return
        if self._request and self._request.goal:  # nobody waits for one of a stream
            self._end(Outcome(ErrorCode.INVALID_GOAL, "Current goal preempted by new incoming action"))
        self._trajectory, self._request, self._moving = trajectory, request, True
        self._feedback.begin(hw.time)

    def _monitor(self, request: TrajectoryRequest, hw: ValorEscherHWInterface) -> None:
        """Compare with the measured state: tolerances on the way and at the end."""
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
        """From the motion commanded now: decelerate, or stand still at once; then hold."""
        settings = self.settings
        if settings.decelerate_on_cancel:
            self._trajectory = Trajectory.stopping(
                hw.time, self.position, self.velocity, settings.max_deceleration, self.limits
            )
        else:
            self._trajectory = Trajectory.holding(hw.time, self.position)
        self._moving = True

    def _end(self, outcome: Outcome) -> None:
        """Nobody waits for the trajectory any more."""
        request, self._request = self._request, None
        if request is None:
            return
        failed = not outcome.canceled and outcome.code is not ErrorCode.SUCCESSFUL
        if request.goal:
            request.goal.finish(outcome)
        elif failed:
            self.refusals.tell(outcome.text)
        if failed:
            self._log.warning(f"{self.name}: {outcome.text}")
