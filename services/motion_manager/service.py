"""The loop: a Proprioceptor comes, its Motor leaves, and then everything that can wait a little."""

from __future__ import annotations

import logging
import time

import numpy as np

from motion_manager.hand_goals import SIDES
from motion_manager.manager import MotionManager
from valor_common.messages import (
    BalanceWeights,
    BehaviorReply,
    BehaviorRequest,
    DeviceStatus,
    FootstepPlanReply,
    FootstepPlanRequest,
    HandGoal,
    HandGoalStatus,
    JointGains,
    JointSetpoints,
    MotionState,
    Motor,
    PelvisSetpoint,
    Proprioceptor,
    Rejection,
    StepStatus,
    VelocityCommand,
)
from valor_common.model import controller_model
from valor_common.service import Context, quiet_collector
from valor_common.topics import (
    BALANCE_WEIGHTS,
    BEHAVIOR,
    DEVICES,
    FOOTSTEP_PLAN,
    HAND_GOAL,
    HAND_GOAL_STATUS,
    JOINT_GAINS,
    JOINT_SETPOINTS,
    MOTION_STATE,
    MOTOR,
    PELVIS,
    PROPRIOCEPTOR,
    REJECTION,
    STEP_STATUS,
    VELOCITY,
)

SETPOINT_QUEUE = 16  # joints' and pelvis': more than that in one control period are dropped and counted
VELOCITY_QUEUE = 4  # likewise
DEMAND_QUEUE = 4  # likewise, of what comes on demand: hand goals, gains, weights
HAND_STATUS_PERIOD = 0.1  # while a goal leads a hand [s of robot time]
STEP_STATUS_PERIOD = 0.1  # [s of robot time]
SILENCE = 2.0  # without a Proprioceptor for so long, this is not in control of a robot [s]
NAP = 0.02  # between looks at requests while no Proprioceptor comes [s]

_log = logging.getLogger("motion_manager")


class MotionManagerService:
    """Bifrost around the ``MotionManager``."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._statistics = context.statistics
        self._statistics.state("starting", "building the Whole-Body Controller")
        node = context.node
        self._manager = MotionManager(context.robot, controller_model(context.robot))
        self._motor = node.publisher(MOTOR.name, Motor)
        self._motion_state = node.publisher(MOTION_STATE.name, MotionState)
        self._rejection = node.publisher(REJECTION.name, Rejection)
        self._step_status = node.publisher(STEP_STATUS.name, StepStatus)
        self._setpoints = node.subscriber(JOINT_SETPOINTS.name, JointSetpoints, queue=SETPOINT_QUEUE)
        self._velocity = node.subscriber(VELOCITY.name, VelocityCommand, queue=VELOCITY_QUEUE)
        self._pelvis = node.subscriber(PELVIS.name, PelvisSetpoint, queue=SETPOINT_QUEUE)
        self._hand_goal = node.subscriber(HAND_GOAL.name, HandGoal, queue=DEMAND_QUEUE)
        self._hand_status = node.publisher(HAND_GOAL_STATUS.name, HandGoalStatus)
        self._hand_changes = 0
        self._hand_status_due = 0
        self._gains = node.subscriber(JOINT_GAINS.name, JointGains, queue=DEMAND_QUEUE)
        self._weights = node.subscriber(BALANCE_WEIGHTS.name, BalanceWeights, queue=DEMAND_QUEUE)
        self._inputs = (
            self._setpoints, self._velocity, self._pelvis, self._hand_goal, self._gains, self._weights,
        )  # fmt: skip
        self._behavior = node.server(
            BEHAVIOR.name, BehaviorRequest, BehaviorReply, self._manager.behavior_handler.handle
        )
        self._footstep_plan = node.server(
            FOOTSTEP_PLAN.name, FootstepPlanRequest, FootstepPlanReply, self._manager.footstep_handler.handle
        )
        self._devices = node.subscriber(DEVICES.name, DeviceStatus)
        # Last, when everything is ready to answer it: the newest alone, for what is older has passed.
        self._proprioceptor = node.subscriber(PROPRIOCEPTOR.name, Proprioceptor)
        self._changes = self._manager.fsm.changes
        self._step_status_due = 0
        self._step_changes = 0

    def run(self) -> None:
        """Answer every Proprioceptor until told to stop."""
        quiet_collector()
        np.seterr(all="ignore")  # what is not finite is looked for and dealt with where it matters
        self._wait_for_robot(f"no {PROPRIOCEPTOR.name} yet")
        heard = time.perf_counter()
        while not self._context.stopping.is_set():
            received = self._proprioceptor.receive(NAP)
            began = time.perf_counter()
            if received is not None and received.origin != PROPRIOCEPTOR.publisher:
                # A bag played back into a running system must not be taken for the robot.
                reason = f"comes from {received.origin}; expected {PROPRIOCEPTOR.publisher}"
                self._manager.rejections.add(PROPRIOCEPTOR.name, received.origin, "origin", reason)
            elif received is not None:
                heard = began
                self._tick(received.message, began)
                self._attend()
                self._statistics.cycle(began)
                continue
            if began - heard > SILENCE:
                self._wait_for_robot(f"{PROPRIOCEPTOR.name} is silent: is the Comms Manager running?")
            self._attend()
            self._statistics.idle()

    def close(self) -> None:
        """Nothing: the node belongs to the context."""

    def _wait_for_robot(self, why: str) -> None:
        """Say that no robot is in our hands."""
        if self._manager.silent != why:
            self._manager.silent = why
            self._statistics.state("starting", why)

    def _tick(self, proprioceptor: Proprioceptor, began: float) -> None:
        """One control period: the Motor first."""
        manager = self._manager
        for received in self._setpoints.drain():
            manager.setpoints_handler.handle(received, manager.time, manager.taken_over)
        for command in self._velocity.drain():
            manager.velocity_handler.handle(command, manager.time)
        for pelvis in self._pelvis.drain():
            manager.pelvis_handler.handle(pelvis, manager.time)
        for goal in self._hand_goal.drain():
            manager.hand_goal_handler.handle(goal, manager.time)
        for gains in self._gains.drain():
            manager.tuning_handler.handle_gains(gains)
        for weights in self._weights.drain():
            manager.tuning_handler.handle_weights(weights)
        self._motor.publish(manager.tick(proprioceptor))
        self._motion_state.publish(manager.report(time.perf_counter() - began))
        if manager.in_control and manager.silent:
            manager.silent = ""
            self._statistics.state("ready")

    def _attend(self) -> None:
        """What may wait until the Motor has left: requests, reports, counts."""
        manager = self._manager
        if (devices := self._devices.latest()) is not None and devices.origin == DEVICES.publisher:
            manager.device_reactions.hear(devices.message)
        self._behavior.serve()
        self._footstep_plan.serve()
        for rejection in manager.rejections.take():
            self._rejection.publish(rejection)
        changed = manager.footstep_handler.changes != self._step_changes
        if changed or manager.time >= self._step_status_due or manager.time < self._step_status_due - 1e9:
            self._step_changes = manager.footstep_handler.changes
            self._step_status_due = manager.time + round(STEP_STATUS_PERIOD * 1e9)
            self._step_status.publish(manager.footstep_handler.status(manager.time))
        self._report_hands()
        if manager.fsm.changes != self._changes:
            self._changes = manager.fsm.changes
            _log.info("behavior %s: %s", manager.fsm.behavior, manager.fsm.reason)
        self._statistics.rejected = (
            manager.rejections.total
            + sum(subscriber.rejected for subscriber in self._inputs)
            + self._proprioceptor.rejected
            + self._behavior.rejected
            + self._footstep_plan.rejected
        )
        self._statistics.drops = manager.missed + sum(subscriber.drops for subscriber in self._inputs)

    def _report_hands(self) -> None:
        """On change, and every now and then while a goal leads a hand."""
        goals, time = self._manager.hand_goals, self._manager.time
        changed = goals.changes != self._hand_changes
        due = goals.active and not self._hand_status_due - 1e9 < time < self._hand_status_due
        if changed or due:
            self._hand_changes = goals.changes
            self._hand_status_due = time + round(HAND_STATUS_PERIOD * 1e9)
            for side in range(len(SIDES)):
                self._hand_status.publish(goals.status(side, time))
