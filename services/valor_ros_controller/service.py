"""The Valor ROS Controller as a service: connects the core with Bifrost and ROS, and turns the loop.

Three threads (figure 4.2 has six; see ``docs/valor_ros_controller.md``): this one waits for Proprioceptor and
runs the controllers and the publisher; the ROS thread runs callbacks; the behavior commander waits for the Motion
Manager's replies.
"""

from __future__ import annotations

import sys
from functools import partial

from rcl_interfaces.msg import ParameterDescriptor

from valor.common.trace import Stage
from valor.robot.kinematic_tree import KinematicTree
from valor.ros.parameters import Parameters, Range
from valor.service import Context, quiet_collector
from valor.valor_ros_controller.behavior_commander import BehaviorCommander
from valor.valor_ros_controller.core import Core
from valor.valor_ros_controller.ros.faces import Faces
from valor.valor_ros_controller.ros.node import RosThread

SWITCH_INTERVAL = 0.0005
"""How long the ROS thread may keep the interpreter from the update thread [s]; Python's own is ten times that."""
SNAPSHOT_PERIOD = 0.25  # [s]


class ValorRosController:
    """The core, its faces, the loop."""

    def __init__(self, context: Context) -> None:
        """Put them together.

        Raises:
            ConfigurationError: a table, a parameter or the robot's model is wrong.
        """
        self._context = context
        tree = KinematicTree.load(context.robot)
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._ros = RosThread(context)
        try:
            self._assemble(tree, Parameters(self._ros.node))
        except BaseException:
            self._ros.close()
            raise
        self._ros.life.configured()
        self._cycles = 0
        self._next_snapshot = 0.0

    def _assemble(self, tree: KinematicTree, parameters: Parameters) -> None:
        context, refusal = self._context, self._context.settings.ros_refusal
        control_rate = context.robot.tables.control_rate
        rate = parameters.declare(
            "update_rate",
            min(250.0, control_rate),
            "of the update loop [Hz], at most the control rate",
            Range(1.0, control_rate),
        )
        timeout = parameters.declare(
            "silence_timeout", 1.0, "a process that publishes nothing for so long is silent [s]", Range(0.01, 60.0)
        )
        decimation = max(1, round(control_rate / rate))
        self._core = Core(
            context.robot,
            context.node,
            partial(BehaviorCommander, context.node),
            decimation=decimation,
            silence_timeout=timeout,
            refusal=refusal,
        )
        self._ros.node.declare_parameter(
            "allowed_control_modes",
            list(self._core.modes.modes),
            ParameterDescriptor(description="names of all control modes", read_only=True),
        )
        self._faces = Faces(self._ros, parameters, self._core, context, tree=tree, rate=control_rate / decimation)
        interface = self._core.interface
        context.statistics.watch((*interface.heard.values(), *self._faces.bypass.heard), self._ros.floods)
        context.statistics.depend(interface.heard, lambda: self._core.hw.time)
        if refusal:
            parameters.refuse_changes(refusal)

    def run(self) -> None:
        """Turn the loop until told to stop."""
        context, core, faces = self._context, self._core, self._faces
        statistics, trace = context.statistics, context.trace
        self._ros.start()
        quiet_collector()
        while not context.stopping.is_set():
            if measured := core.wait():
                trace.mark(Stage.AWAIT)
                faces.publish_measured()
                trace.mark(Stage.PUBLISH_JOINTS)
            core.update(measured)
            began = core.began
            trace.mark(Stage.CONTROLLERS if measured else Stage.AWAIT)
            self._cycles += measured
            faces.publish(measured)
            if began >= self._next_snapshot:
                self._next_snapshot = began + SNAPSHOT_PERIOD
                self._hand_over()
            if measured:
                statistics.cycle(began)
            else:
                statistics.idle()
            trace.cycle()
            trace.mark(Stage.PUBLISH_ROS)

    def _hand_over(self) -> None:
        """Tell the diagnostics and the statistics how we fare."""
        core, faces, statistics = self._core, self._faces, self._context.statistics
        faces.hand_over(self._cycles)
        statistics.rejected = core.rejected + self._ros.failures + faces.bypass.rejections.own.count
        if silent := core.interface.silent:
            statistics.state("starting", f"waiting for {silent}")
        else:
            statistics.state("ready")
        self._ros.life.tell(not silent, silent)

    def close(self) -> None:
        """End the threads; ROS last but one, the Bifrost node, which is not ours, last."""
        self._ros.close()
        self._core.close()
