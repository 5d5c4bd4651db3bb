"""Footstep Converter as a service: ROS, Motion Manager, plan runner, and the loop."""

import time
from functools import partial

from vigir_footstep_planning_msgs.msg import FootstepExecutionStatus

from valor.footstep_converter.clients import ODOM, Clients, Frames
from valor.footstep_converter.execution import aborted
from valor.footstep_converter.motion_system import ANSWER, MotionSystem
from valor.footstep_converter.runner import PlanRunner
from valor.ros.node import ProcessNode, RosSide
from valor.service import Context, quiet_collector

IDLE_PERIOD = 0.25  # of the loop without a plan [s]
ACTIVE_PERIOD = 0.02  # of the loop with a plan [s]
PAUSED = "the footstep converter is paused (lifecycle state inactive)"
LAST_CYCLES = 10  # to send the last results

_F = FootstepExecutionStatus


class FootstepConverter:
    """Sends plans to the Motion Manager, and its reports to the clients."""

    def __init__(self, context: Context) -> None:
        self._stopping = context.stopping
        self._statistics = context.statistics
        self._motion = MotionSystem(context.node)
        self._side = RosSide(
            context.name, context.settings, context.instance.environment(), context.arguments,
            node=partial(ProcessNode, sets_time=True, others=bool(context.settings.peers)), pause=self._busy,
        )  # fmt: skip
        self._node, self._executor = self._side.node, self._side.executor
        self._plans = PlanRunner(
            context.robot,
            self._motion,
            Frames(self._node, context.settings.frame_prefix),
            context.statistics,
            wake=self._executor.wake,
            rejection=lambda: PAUSED if self._side.life.paused else context.settings.ros_refusal,
        )
        self._clients = Clients(
            self._node,
            self._plans.begin,
            self._plans.cancel,
            now=lambda: self._motion.time,
            frame=context.settings.frame_prefix + ODOM,
        )
        self._side.life.configure()

    def run(self) -> None:
        """Serve until the process is stopped."""
        self._statistics.watch(self._motion.subscribers.values(), self._clients.floods)
        self._statistics.depend(self._motion.subscribers, lambda: self._motion.time)
        self._statistics.state("ready")
        self._side.life.set_ready(True)
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
        """Reason against a pause; empty if there is none."""
        return "" if self._plans.idle else "a plan is being executed; stop it first"

    def _turn(self) -> None:
        self._executor.spin_once(timeout_sec=IDLE_PERIOD if self._plans.idle else ACTIVE_PERIOD)
        self._plans.turn()
        self._node.set_time(self._motion.time)
        self._statistics.drops = self._motion.drops
        self._statistics.idle()

    def _wind_up(self) -> None:
        """Stop the running plan, which would be unattended, and report it to its client."""
        goals = self._clients.open_goals
        if not goals and not self._plans.running:
            return
        text = "the footstep converter is stopping; it requested a stop of the plan"
        outcome = aborted(_F.PREMATURE_HALT | _F.ERR_CONTROLLER_NOT_READY, text)
        stop = self._plans.abandon(outcome)
        for goal in goals:
            goal.end(outcome)
        deadline = time.monotonic() + ANSWER
        while (self._clients.open_goals or not stop.done()) and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=ACTIVE_PERIOD)
        for _ in range(LAST_CYCLES):
            self._executor.spin_once(timeout_sec=ACTIVE_PERIOD)
