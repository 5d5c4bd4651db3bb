"""The Valor ROS Controller as a service: puts its parts together and turns the loop.

Three threads (``docs/valor_ros_controller.md`` holds them against figure 4.2): this one waits for Proprioceptor and
runs the controllers and the publisher; the ROS thread runs callbacks; the behavior commander waits for the Motion
Manager's replies.
"""

from __future__ import annotations

import logging
import sys
from math import nan

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import ParameterDescriptor

from valor.common.behaviors import ControlMode
from valor.common.processes import PROCESSES
from valor.common.trace import Stage
from valor.service import Context, quiet_collector
from valor.valor_ros_controller.behavior_commander import BehaviorCommander
from valor.valor_ros_controller.control_modes import ControlModeTable
from valor.valor_ros_controller.controllers.configuration import ControllersTable
from valor.valor_ros_controller.controllers.control_mode_controller import ControlModeController
from valor.valor_ros_controller.controllers.footstep_controller import FootstepController
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.controllers.tracking_controller import TrackingController
from valor.valor_ros_controller.kinematic_tree import KinematicTree
from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer
from valor.valor_ros_controller.ros.control_mode_action import ControlModeAction
from valor.valor_ros_controller.ros.controller_bypass import ControllerBypass
from valor.valor_ros_controller.ros.controller_manager_services import ControllerManagerServices
from valor.valor_ros_controller.ros.controller_state import ControllerStatePublisher
from valor.valor_ros_controller.ros.diagnostics import Diagnostics, Snapshot
from valor.valor_ros_controller.ros.footstep_state import FootstepStatePublisher
from valor.valor_ros_controller.ros.joint_trajectory_action import JointTrajectoryAction
from valor.valor_ros_controller.ros.motion_state_publisher import MotionStatePublisher
from valor.valor_ros_controller.ros.node import RosThread
from valor.valor_ros_controller.ros.parameters import RATE, Parameters, Range, TrajectoryParameters
from valor.valor_ros_controller.ros.publisher import Publisher
from valor.valor_ros_controller.ros.robot_status import RobotStatusPublisher
from valor.valor_ros_controller.ros.tracking_action import TrackingAction
from valor.valor_ros_controller.valor_escher_controller import ValorEscherController
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface
from valor.valor_ros_controller.valor_escher_interface import ValorEscherInterface

_log = logging.getLogger("valor_ros_controller")

SWITCH_INTERVAL = 0.0005
"""How long the ROS thread may keep the interpreter from the update thread [s]; Python's own is ten times that."""
SNAPSHOT_PERIOD = 0.25  # [s]


class ValorRosController:
    """Everything, from tables to threads."""

    def __init__(self, context: Context) -> None:
        """Put it together.

        Raises:
            ConfigurationError: a table, a parameter or the robot's model is wrong.
        """
        self._context = context
        robot = context.robot
        modes, controllers = ControlModeTable.load(), ControllersTable.load()
        tree = KinematicTree.load(robot)
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._ros = RosThread(context.name, sys.argv[1:])
        try:
            control_rate = robot.tables.control_rate
            self._parameters = Parameters(self._ros.node)
            rate = self._parameters.declare(
                "update_rate",
                min(250.0, control_rate),
                "of the update loop [Hz], at most the control rate",
                Range(1.0, control_rate),
            )
            timeout = self._parameters.declare(
                "silence_timeout",
                1.0,
                "a process that publishes nothing for so long is silent [s]",
                Range(0.01, 60.0),
            )
            self._ros.node.declare_parameter(
                "allowed_control_modes",
                list(modes.modes),
                ParameterDescriptor(description="names of all control modes", read_only=True),
            )
            self._assemble(modes, controllers, tree, max(1, round(control_rate / rate)), timeout)
        except BaseException:
            self._ros.close()
            raise

    def _assemble(
        self,
        modes: ControlModeTable,
        controllers: ControllersTable,
        tree: KinematicTree,
        decimation: int,
        silence_timeout: float,
    ) -> None:
        context, node = self._context, self._ros.node
        robot = context.robot
        rate = robot.tables.control_rate / decimation
        self._stamp = Time()
        self._hw = ValorEscherHWInterface(robot)
        self._interface = ValorEscherInterface(
            context.node, BehaviorCommander(context.node), self._hw, decimation, silence_timeout
        )
        mode_controller = ControlModeController(modes, self._interface)
        mode_controller.refusal = refusal = context.settings.ros_refusal
        trajectories = {
            name: JointTrajectoryController(name, config, self._hw, modes.running(name))
            for name, config in (controllers.joint_controllers | controllers.robot_controllers).items()
        }
        tracking = {
            name: TrackingController(name, config, self._hw)
            for name, config in controllers.tracking_controllers.items()
        }
        footsteps = FootstepController(self._interface)
        self._controller = ValorEscherController(
            table=modes,
            hw=self._hw,
            interface=self._interface,
            mode_controller=mode_controller,
            joint_controllers=[*(trajectories[name] for name in controllers.joint_controllers), *tracking.values()],
            robot_controllers=[footsteps, *(trajectories[name] for name in controllers.robot_controllers)],
        )
        self._publisher = Publisher(
            node, robot, tree, self._stamp, rate=rate, simulated=context.settings.profile != "hardware"
        )
        self._interface.measured = self._measured
        self._bypass = ControllerBypass(
            node,
            context.node,
            self._interface,
            (tree.base_frame, tree.base),
            soft_stop=lambda: mode_controller.request(ControlMode.SOFT_STOP),
            refusal=refusal,
        )
        context.statistics.watch((*self._interface.heard.values(), *self._bypass.heard), self._ros.floods)
        context.statistics.depend(self._interface.heard, lambda: self._hw.time)
        self._motion = MotionStatePublisher(node, self._stamp, rate)
        self._status = RobotStatusPublisher(node, self._interface)
        self._mode_face = ControlModeAction(node, mode_controller, self._stamp)
        self._trajectories = list(trajectories.values())
        self._joint_states = self._open_controllers(controllers, trajectories, tracking)
        self._footsteps = FootstepStatePublisher(node, footsteps, self._stamp)
        self._managers = ControllerManagerServices(
            node,
            self._controller,
            self._hw,
            rate=rate,
            stamp=self._stamp,
            silent=lambda: self._interface.silent,
            refusal=refusal,
        )
        self._snapshots: RealTimeBuffer[Snapshot] = RealTimeBuffer()
        hardware = context.settings.variant == "hardware"
        processes = [process.name for process in PROCESSES if hardware or not process.hardware_only]
        self._diagnostics = Diagnostics(node, context.node, self._snapshots, rate, processes)
        self._cycles = 0
        self._next_snapshot = 0.0
        if refusal:
            self._parameters.refuse_changes(refusal)

    def _open_controllers(
        self,
        table: ControllersTable,
        trajectories: dict[str, JointTrajectoryController],
        tracking: dict[str, TrackingController],
    ) -> list[ControllerStatePublisher]:
        """Parameters, actions and topics of the trajectory and tracking controllers."""
        node, parameters, queue = self._ros.node, self._parameters, self._controller.queue
        refusal = self._context.settings.ros_refusal
        configs = table.joint_controllers | table.robot_controllers
        states = []
        for name, controller in trajectories.items():
            TrajectoryParameters(parameters, controller, configs[name])
            JointTrajectoryAction(node, f"{table.namespace}/{name}", controller, self._stamp, queue, refusal=refusal)
            states.append(self._open_state(table, name, controller, configs[name].state_publish_rate))
        for name, follower in tracking.items():
            TrackingAction(node, f"{table.namespace}/{name}", follower)
            states.append(self._open_state(table, name, follower, table.tracking_controllers[name].state_publish_rate))
        return states

    def _open_state(
        self, table: ControllersTable, name: str, controller: object, default: float
    ) -> ControllerStatePublisher:
        topic = f"{table.namespace}/{name}/controller_state"
        publisher = ControllerStatePublisher(self._ros.node, topic, controller, self._stamp, default)

        def change(rate: float) -> None:
            publisher.rate = rate

        parameter = f"{name}.state_publish_rate"
        change(self._parameters.declare(parameter, default, "of ~/controller_state [Hz]", RATE, change))
        return publisher

    def run(self) -> None:
        """Turn the loop until told to stop."""
        context, hw = self._context, self._hw
        statistics, trace = context.statistics, context.trace
        self._ros.start()
        quiet_collector()
        while not context.stopping.is_set():
            measured = self._controller.update()
            began = self._controller.began
            trace.mark(Stage.CONTROLLERS if measured else Stage.AWAIT)
            if measured:
                self._cycles += 1
                self._publisher.publish(hw)
                for state in self._joint_states:
                    state.publish(hw)
                self._motion.publish(self._interface.motion_state)
                self._bypass.update(self._controller.mode_controller.current, hw)
            self._mode_face.publish(hw.time)
            self._footsteps.publish()
            self._managers.publish()
            self._status.publish(self._controller.mode_controller.current)
            if began >= self._next_snapshot:
                self._next_snapshot = began + SNAPSHOT_PERIOD
                self._hand_over()
            if measured:
                statistics.cycle(began)
            else:
                statistics.idle()
            trace.cycle()
            trace.mark(Stage.PUBLISH_ROS)

    def _measured(self) -> None:
        """A cycle's measurement is there."""
        trace = self._context.trace
        trace.mark(Stage.AWAIT)
        self._stamp.sec, self._stamp.nanosec = divmod(self._hw.time, 1_000_000_000)
        self._publisher.publish_joints(self._hw)
        trace.mark(Stage.PUBLISH_JOINTS)

    def _hand_over(self) -> None:
        """Tell the diagnostics and the statistics how we fare."""
        interface, controller, hw = self._interface, self._controller, self._hw
        mode, joints = controller.mode_controller, controller.joints
        statistics = self._context.statistics
        refused = [c for c in self._trajectories if c.last_refusal]
        snapshot = Snapshot(
            silent=interface.silent,
            behavior=interface.behavior,
            behavior_reason=interface.behavior_reason,
            proprioceptor_age=interface.proprioceptor_age,
            motion_state_age=interface.motion_state_age,
            messages_rejected=interface.rejected,
            battery_voltage=hw.measured.battery_voltage if hw.measured else nan,
            last_command_refusal=self._bypass.last_refusal,
            commands_refused=self._bypass.refusals,
            set_points_sent=interface.set_points_sent,
            set_points_clamped=hw.clamped,
            cycles=self._cycles,
            control_mode=mode.current,
            last_mode_refusal=mode.last_refusal,
            modes_refused=mode.rejected,
            joint_controllers=joints.active,
            last_trajectory_refusal="; ".join(c.last_refusal for c in refused),
            trajectories_refused=sum(c.rejected for c in self._trajectories),
        )
        self._snapshots.write(snapshot)
        statistics.rejected = (
            snapshot.messages_rejected
            + snapshot.modes_refused
            + snapshot.trajectories_refused
            + self._ros.failures
            + self._bypass.rejected
        )
        if interface.silent:
            statistics.state("starting", f"waiting for {interface.silent}")
        else:
            statistics.state("ready")

    def close(self) -> None:
        """End the threads; ROS last but one, the Bifrost node, which is not ours, last."""
        self._ros.close()
        self._interface.close()
