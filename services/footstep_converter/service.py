"""The Footstep Converter as a service: ROS, the Motion Manager and the plan runner between them, and the loop."""

from __future__ import annotations

import time
from functools import partial

from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus

from valor.footstep_converter.clients import Clients
from valor.footstep_converter.execution import aborted
from valor.footstep_converter.frames import ODOM, Frames
from valor.footstep_converter.motion_system import ANSWER, MotionSystem
from valor.footstep_converter.runner import PlanRunner
from valor.ros.node import ProcessNode, RosSide
from valor.service import Context, quiet_collector

IDLE_PERIOD = 0.25  # between looks at the clock without a plan [s]
ACTIVE_PERIOD = 0.02  # between looks at the Motion Manager with one [s]
PAUSED = "the footstep converter is paused (lifecycle state inactive)"
LAST_TURNS = 10  # in which the results of the last goals leave

_F = FootstepExecutionStatus


class FootstepConverter:
    """Takes plans to the Motion Manager and its words about them back."""

    def __init__(self, context: Context) -> None:
        self._stopping = context.stopping
        self._statistics = context.statistics
        self._motion = MotionSystem(context.node)
        self._side = RosSide(
            context.name, context.settings, context.instance.environment(), context.arguments,
            node=partial(ProcessNode, knows_time=True), pause=self._busy,
        )  # fmt: skip
        self._node, self._executor = self._side.node, self._side.executor
        self._plans = PlanRunner(
            context.robot,
            self._motion,
            Frames(self._node, context.settings.frame_prefix),
            context.statistics,
            wake=self._executor.wake,
            refusal=lambda: PAUSED if self._side.life.paused else context.settings.ros_refusal,
        )
        self._clients = Clients(
            self._node,
            self._executor,
            self._plans.begin,
            self._plans.cancel,
            now=lambda: self._motion.time,
            frame=context.settings.frame_prefix + ODOM,
            others=bool(context.settings.peers),
        )
        self._side.life.configured()

    def run(self) -> None:
        """Serve until told to stop."""
        self._statistics.watch(self._motion.heard.values(), self._clients.floods)
        self._statistics.depend(self._motion.heard, lambda: self._motion.time)
        self._statistics.state("ready")
        self._side.life.tell(True)
        quiet_collector()
        while not self._stopping.is_set():
            self._turn()
        self._wind_up()

    def close(self) -> None:
        """Leave ROS and Bifrost."""
        self._motion.close()
        self._clients.close()
        self._side.close()

    def _busy(self) -> str:
        """Why no pause now."""
        return "" if self._plans.idle else "a plan is under way; stop it first"

    def _turn(self) -> None:
        self._executor.spin_once(timeout_sec=IDLE_PERIOD if self._plans.idle else ACTIVE_PERIOD)
        self._plans.turn()
        self._node.tell_time(self._motion.time)
        self._statistics.drops = self._motion.drops
        self._statistics.idle()

    def _wind_up(self) -> None:
        """Told to stop in mid-plan: nobody would follow it, so it stops too, and its client hears why."""
        goals = self._clients.open_goals
        if not goals and not self._plans.running:
            return
        text = "the footstep converter is stopping; the plan was told to stop"
        outcome = aborted(_F.PREMATURE_HALT | _F.ERR_CONTROLLER_NOT_READY, text)
        stop = self._plans.abandon(outcome)
        for goal in goals:
            goal.end(outcome)
        deadline = time.monotonic() + ANSWER
        while (self._clients.open_goals or not stop.done()) and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=ACTIVE_PERIOD)
        for _ in range(LAST_TURNS):
            self._executor.spin_once(timeout_sec=ACTIVE_PERIOD)
