"""Service: connects the core with Bifrost and ROS, and runs the update loop.

Three threads (see ``docs/valor_ros_controller.md``): the main thread waits for Proprioceptor, runs the controllers and
publishes; the ROS thread runs callbacks; the behavior commander waits for the Motion Manager's replies.
"""

import sys
from collections.abc import Mapping
from functools import partial
from typing import Any

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import ParameterDescriptor

from valor.common.behaviors import ControlMode
from valor.common.processes import PROCESSES
from valor.common.trace import Stage
from valor.robot.kinematic_tree import KinematicTree
from valor.ros.parameters import Parameters, Range
from valor.ros.transforms import ODOM
from valor.service import Context, quiet_collector
from valor.valor_ros_controller.controllers.configuration import (
    Settings,
    TrackingControllerConfig,
    TrajectoryControllerConfig,
)
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.core import Core
from valor.valor_ros_controller.ros.balance_controllers import BalanceControllers
from valor.valor_ros_controller.ros.control_mode_action import COMMAND, ControlModeAction
from valor.valor_ros_controller.ros.controller_bypass import ControllerBypass
from valor.valor_ros_controller.ros.controller_manager_services import ControllerManagerServices
from valor.valor_ros_controller.ros.limb_interfaces import (
    ControllerStatePublisher,
    JointTrajectoryAction,
    Limb,
    serve_tracking,
)
from valor.valor_ros_controller.ros.node import RosThread
from valor.valor_ros_controller.ros.publisher import Publisher, publish_static
from valor.valor_ros_controller.ros.status_publishers import (
    Diagnostics,
    MotionStatePublisher,
    RobotStatusPublisher,
)
from valor.valor_ros_controller.valor_escher_interface import BehaviorCommander

SWITCH_INTERVAL = 0.0005
"""Longest time the ROS thread holds the interpreter [s]; default of Python: 0.005."""
REPORT_PERIOD = 0.25  # [s]
RATE = Range(0.1, 500.0)
_TOLERANCE = Range(0.0, 100.0)
_ABOUT: Mapping[str, tuple[str, Range | None]] = {  # parameters of a controller, and of each joint
    "allow_partial_joints_goal": ("joints may be left out of a trajectory", None),
    "action_monitor_rate": ("of feedback [Hz]", RATE),
    "constraints.goal_time": ("largest delay of a goal [s]; 0: unlimited", Range(0.0, 3600.0)),
    "constraints.stopped_velocity_tolerance": ("velocity at the goal [rad/s or m/s]; 0: not checked", _TOLERANCE),
    "constraints.decelerate_on_cancel": ("stop with max_deceleration_on_cancel, else at once", None),
    "trajectory": ("path tolerance [rad or m]; 0: not checked", _TOLERANCE),
    "goal": ("goal tolerance [rad or m]; 0: not checked", _TOLERANCE),
    "max_deceleration_on_cancel": ("[rad/s² or m/s²]", Range(0.01, 1000.0)),
}


class ValorRosController:
    """Valor ROS Controller."""

    def __init__(self, context: Context) -> None:
        """Create all parts. Raises ConfigurationError: a table, a parameter or the robot's model is invalid."""
        self._context = context
        tree = KinematicTree.load(context.robot)
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._ros = RosThread(context)
        try:
            self._parameters = Parameters(self._ros.node)
            self._open_ros(tree, self._create_core(tree))
        except BaseException:
            self._ros.close()
            raise
        self._ros.life.configure()
        self._next_report = 0.0

    def _create_core(self, tree: KinematicTree) -> float:
        """Create the core; returns the rate of the update loop [Hz]."""
        context = self._context
        control_rate = context.robot.tables.control_rate
        update_rate = self._parameters.declare(
            "update_rate",
            min(250.0, control_rate),
            "of the update loop [Hz], at most the control rate",
            Range(1.0, control_rate),
        )
        timeout = self._parameters.declare(
            "silence_timeout", 1.0, "of a process that stops publishing [s]", Range(0.01, 60.0)
        )
        decimation = max(1, round(control_rate / update_rate))
        self._core = Core(
            context.robot,
            context.node,
            partial(BehaviorCommander, context.node),
            decimation=decimation,
            silence_timeout=timeout,
            rejection=context.settings.ros_refusal,
            tree=tree,
        )
        self._ros.node.declare_parameter(
            "allowed_control_modes",
            list(self._core.modes.modes),
            ParameterDescriptor(description="names of all control modes", read_only=True),
        )
        return control_rate / decimation

    def _open_ros(self, tree: KinematicTree, rate: float) -> None:
        """Open all interfaces; publishers run in the update thread, callbacks in the ROS thread."""
        context, settings, core, node = self._context, self._context.settings, self._core, self._ros.node
        rejection = settings.ros_refusal
        self._stamp = stamp = Time()
        prefix = self._parameters.declare("frame_prefix", settings.frame_prefix, "of the robot's frames in tf")
        odom, base = prefix + ODOM, prefix + tree.base_frame
        simulated = settings.variant == "simulation"
        self._publisher = Publisher(node, context.robot, tree, stamp, rate=rate, simulated=simulated, prefix=prefix)
        publish_static(node, self._parameters, self._publisher.transforms.fixed, odom)
        rate_of_control, behavior = context.robot.tables.control_rate, lambda: core.interface.behavior
        self._balance = BalanceControllers(node, context.node, behavior, rate=rate_of_control, rejection=rejection)
        self._bypass = ControllerBypass(
            node,
            context.node,
            core.interface,
            {base: "pelvis", prefix + tree.base: "pelvis", odom: "odom"},
            soft_stop=lambda: core.mode_controller.request(ControlMode.SOFT_STOP),
            choose=self._balance.choose,
            rejection=rejection,
        )
        rejections = self._bypass.rejections
        self._motion = MotionStatePublisher(node, context.robot.tables.hands, stamp, rate, odom)
        self._status = RobotStatusPublisher(node, core.interface, core.hw)
        self._modes = ControlModeAction(node, core.mode_controller, stamp)
        rejections.add_source(COMMAND, core.mode_controller.rejections)
        self._controller_states = self._open_controllers()
        self._managers = ControllerManagerServices(node, core, rate=rate, rejection=rejection)
        processes = [
            process.name
            for process in PROCESSES
            if (not process.option or process.name in settings.asked)
            and (settings.variant == "hardware" or not process.hardware_only)
        ]
        self._diagnostics = Diagnostics(node, context.node, core, rejections, rate=rate, processes=processes)
        subscribers = core.interface.subscribers
        context.statistics.watch((*subscribers.values(), *self._bypass.subscribers), self._ros.floods)
        context.statistics.depend(subscribers, lambda: core.hw.time)
        if rejection:
            self._parameters.reject_changes(rejection)

    def _open_controllers(self) -> list[ControllerStatePublisher]:
        """Open parameters, actions and topics of the trajectory and tracking controllers."""
        node, core, table, rejection = self._ros.node, self._core, self._core.table, self._context.settings.ros_refusal
        configs, followed = table.of_type(TrajectoryControllerConfig), table.of_type(TrackingControllerConfig)
        states = []
        for name, controller in core.trajectories.items():
            _declare_settings(self._parameters, controller, configs[name])
            bases = table.bases(name)
            action = JointTrajectoryAction(node, bases, controller, self._stamp, core.queue, rejection=rejection)
            self._bypass.rejections.add_source(action.topic, controller.rejections)
            states.append(self._open_state(name, controller, configs[name].state_publish_rate))
        for name, follower in core.tracking.items():
            serve_tracking(node, table.bases(name), follower)
            states.append(self._open_state(name, follower, followed[name].state_publish_rate))
        return states

    def _open_state(self, name: str, controller: Limb, default: float) -> ControllerStatePublisher:
        topics = [f"{base}/controller_state" for base in self._core.table.bases(name)]
        publisher = ControllerStatePublisher(self._ros.node, topics, controller, self._stamp, default)

        def change(rate: float) -> None:
            publisher.rate = rate

        parameter = f"{name}.state_publish_rate"
        change(self._parameters.declare(parameter, default, "of ~/controller_state [Hz]", RATE, change))
        return publisher

    def run(self) -> None:
        context, core = self._context, self._core
        statistics, trace = context.statistics, context.trace
        self._ros.start()
        quiet_collector()
        while not context.stopping.is_set():
            if measured := core.wait():
                trace.mark(Stage.AWAIT)
                self._publish_measured()
                trace.mark(Stage.PUBLISH_JOINTS)
            core.update(measured)
            began = core.began
            trace.mark(Stage.CONTROLLERS if measured else Stage.AWAIT)
            self._publish(measured)
            if began >= self._next_report:
                self._next_report = began + REPORT_PERIOD
                self._report()
            if measured:
                statistics.cycle(began)
            else:
                statistics.idle()
            trace.cycle()
            trace.mark(Stage.PUBLISH_ROS)

    def _publish_measured(self) -> None:
        """Publish what depends only on the measurement, as soon as it is received."""
        hw = self._core.hw
        self._stamp.sec, self._stamp.nanosec = divmod(hw.time, 1_000_000_000)
        self._ros.node.set_time(hw.time)
        self._publisher.publish_measured(hw)

    def _publish(self, measured: bool) -> None:
        """Publish a cycle; ``measured``: with a measurement."""
        core = self._core
        hw, mode = core.hw, core.mode_controller.current
        if measured:
            self._publisher.publish(hw)
            for state in self._controller_states:
                state.publish(hw)
            self._motion.publish(core.interface.motion_state)
            self._bypass.update(mode, hw, core.mode_controller.stops)
        self._bypass.report(measured=measured)
        self._modes.publish(hw.time)
        self._status.publish(mode)

    def _report(self) -> None:
        core, statistics = self._core, self._context.statistics
        statistics.rejected = core.rejected + self._ros.failures + self._bypass.rejections.own.count
        if silent := core.interface.silent:
            statistics.state("starting", f"waiting for {silent}")
        else:
            statistics.state("ready")
        self._ros.life.set_ready(not silent, silent)

    def close(self) -> None:
        """End the threads; ROS first. The owner closes the Bifrost node."""
        self._ros.close()
        self._balance.close()
        self._core.close()


def _declare_settings(
    parameters: Parameters, controller: JointTrajectoryController, config: TrajectoryControllerConfig
) -> None:
    """Declare the parameters of a controller, named as ``joint_trajectory_controller``'s; defaults from ``config``.

    Raises ConfigurationError: one was set to an invalid value at start.
    """
    joints = controller.limits.names
    values = config.parameters(joints)

    def change(key: str, value: Any) -> None:
        values[key] = value
        controller.settings = Settings.of(values, joints)

    for key, default in values.items():
        about = _ABOUT.get(key) or _ABOUT[key.rpartition(".")[2]]
        change(key, parameters.declare(f"{controller.name}.{key}", default, *about, partial(change, key)))
