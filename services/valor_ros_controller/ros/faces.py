"""All that ROS sees of the core and asks of it: topics, services, actions and parameters, put together."""

from __future__ import annotations

import time
from math import nan

from builtin_interfaces.msg import Time

from valor.common.behaviors import ControlMode
from valor.common.processes import PROCESSES
from valor.robot.kinematic_tree import KinematicTree
from valor.ros.parameters import Parameters
from valor.ros.transforms import ODOM
from valor.service import Context
from valor.valor_ros_controller.core import Core
from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer
from valor.valor_ros_controller.ros.control_mode_action import COMMAND, ControlModeAction
from valor.valor_ros_controller.ros.controller_bypass import ControllerBypass
from valor.valor_ros_controller.ros.controller_manager_services import ControllerManagerServices
from valor.valor_ros_controller.ros.controller_state import ControllerStatePublisher, Limb
from valor.valor_ros_controller.ros.diagnostics import Diagnostics, Snapshot
from valor.valor_ros_controller.ros.footstep_state import FootstepStatePublisher
from valor.valor_ros_controller.ros.joint_trajectory_action import JointTrajectoryAction
from valor.valor_ros_controller.ros.motion_state_publisher import MotionStatePublisher
from valor.valor_ros_controller.ros.node import RosThread
from valor.valor_ros_controller.ros.parameters import RATE, TrajectoryParameters
from valor.valor_ros_controller.ros.publisher import Publisher
from valor.valor_ros_controller.ros.robot_status import RobotStatusPublisher
from valor.valor_ros_controller.ros.static_transforms import StaticTransforms
from valor.valor_ros_controller.ros.tracking_action import TrackingAction


class Faces:
    """What they publish is published in the update thread; what they are asked comes in the ROS thread.

    Attributes:
        bypass: what passes the controllers by.
    """

    def __init__(
        self, ros: RosThread, parameters: Parameters, core: Core, context: Context, *, tree: KinematicTree, rate: float
    ) -> None:
        """Open them.

        Args:
            ros: whose node.
            parameters: of the node.
            core: what is shown.
            context: of the process.
            tree: links and frames.
            rate: of the update loop [Hz].

        Raises:
            ConfigurationError: a parameter was set at start to what it cannot be.
        """
        node, refusal = ros.node, context.settings.ros_refusal
        self._node, self._parameters, self._core, self._refusal = node, parameters, core, refusal
        self._stamp = stamp = Time()
        self._period = context.robot.control_period
        simulated = context.settings.variant == "simulation"
        prefix = parameters.declare("frame_prefix", context.settings.frame_prefix, "of the robot's frames in tf")
        odom = prefix + ODOM
        self._publisher = Publisher(node, context.robot, tree, stamp, rate=rate, simulated=simulated, prefix=prefix)
        self._static = StaticTransforms(
            node, parameters, self._publisher.transforms.fixed, odom, prefix + tree.base_frame
        )
        self.bypass = ControllerBypass(
            node,
            context.node,
            core.interface,
            {prefix + tree.base_frame: "pelvis", prefix + tree.base: "pelvis", odom: "odom"},
            soft_stop=lambda: core.mode_controller.request(ControlMode.SOFT_STOP),
            refusal=refusal,
        )
        self._motion = MotionStatePublisher(node, context.robot.tables.hands, stamp, rate, odom)
        self._status = RobotStatusPublisher(node, core.interface)
        self._modes = ControlModeAction(node, core.mode_controller, stamp)
        self.bypass.rejections.tell_of(COMMAND, core.mode_controller.refusals)
        self._joint_states = self._open_controllers()
        self._footsteps = FootstepStatePublisher(node, core.footsteps, stamp, odom)
        self._managers = ControllerManagerServices(
            node,
            core.switch,
            core.queue,
            core.hw,
            rate=rate,
            stamp=stamp,
            silent=lambda: core.interface.silent,
            refusal=refusal,
        )
        self._snapshots: RealTimeBuffer[Snapshot] = RealTimeBuffer()
        hardware, asked = context.settings.variant == "hardware", context.settings.asked
        usual = (process for process in PROCESSES if not process.option or process.name in asked)
        processes = [process.name for process in usual if hardware or not process.hardware_only]
        self._diagnostics = Diagnostics(node, context.node, self._snapshots, rate, processes)

    def _open_controllers(self) -> list[ControllerStatePublisher]:
        """Parameters, actions and topics of the trajectory and tracking controllers."""
        node, core, table = self._node, self._core, self._core.table
        configs = table.joint_controllers | table.robot_controllers
        states = []
        for name, controller in core.trajectories.items():
            TrajectoryParameters(self._parameters, controller, configs[name])
            action = JointTrajectoryAction(
                node, table.bases(name), controller, self._stamp, core.queue, refusal=self._refusal
            )
            self.bypass.rejections.tell_of(action.topic, controller.refusals)
            states.append(self._open_state(name, controller, configs[name].state_publish_rate))
        for name, follower in core.tracking.items():
            TrackingAction(node, table.bases(name), follower)
            states.append(self._open_state(name, follower, table.tracking_controllers[name].state_publish_rate))
        return states

    def _open_state(self, name: str, controller: Limb, default: float) -> ControllerStatePublisher:
        topics = [f"{base}/controller_state" for base in self._core.table.bases(name)]
        publisher = ControllerStatePublisher(self._node, topics, controller, self._stamp, default)

        def change(rate: float) -> None:
            publisher.rate = rate

        parameter = f"{name}.state_publish_rate"
        change(self._parameters.declare(parameter, default, "of ~/controller_state [Hz]", RATE, change))
        return publisher

    def publish_measured(self) -> None:
        """Publish what waits for nothing but the measurement, as soon as it is there."""
        hw = self._core.hw
        self._stamp.sec, self._stamp.nanosec = divmod(hw.time, 1_000_000_000)
        self._node.tell_time(hw.time)
        self._publisher.publish_measured(hw)

    def publish(self, measured: bool) -> None:
        """Publish a cycle; ``measured``: one with a measurement."""
        core = self._core
        hw, mode = core.hw, core.mode_controller.current
        if measured:
            self._publisher.publish(hw)
            for state in self._joint_states:
                state.publish(hw)
            self._motion.publish(core.interface.motion_state)
            self.bypass.update(mode, hw, core.mode_controller.stops)
        self.bypass.report(measured=measured)
        self._modes.publish(hw.time)
        self._footsteps.publish()
        self._managers.publish()
        self._status.publish(mode)

    def hand_over(self, cycles: int) -> None:
        """Give the diagnostics how the core fares, after so many cycles."""
        core, bypass = self._core, self.bypass
        interface, modes, hw, trajectories = core.interface, core.mode_controller, core.hw, core.trajectories.values()
        voltage = hw.measured.battery_voltage if hw.measured else nan
        motion_system = {
            "proprioceptor age [s]": f"{interface.proprioceptor_age:.3f}",
            "motion_state age [s]": f"{interface.motion_state_age:.3f}",
            "messages rejected": interface.rejected,
            "battery [V]": f"{voltage:.1f}",
            "commands refused": bypass.rejections.refusals,
            "last command refused": bypass.rejections.last,
        }
        controller = {
            "control modes refused": modes.refusals.count,
            "last control mode refused": modes.refusals.last,
            "joint controllers": ", ".join(core.joints.active),
            "trajectories refused": sum(each.refusals.count for each in trajectories),
            "last trajectory refused": "; ".join(each.refusals.last for each in trajectories if each.refusals.last),
            "set-points sent": interface.set_points_sent,
            "set-points clamped": hw.clamped,
        }
        behavior, reason = interface.behavior, interface.behavior_reason
        late, longest = interface.gaps.late, interface.gaps.longest(time.monotonic()) * self._period
        self._snapshots.write(
            Snapshot(
                interface.silent, behavior, reason, modes.current, cycles, late, longest, motion_system, controller
            )
        )
