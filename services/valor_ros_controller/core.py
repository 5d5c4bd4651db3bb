"""Valor ROS Controller without ROS: the Valor Escher Controller (VEC, thesis sections 3.5 and 4.2.1).

A cycle reads, updates modes, switches controllers, updates joint and robot controllers, serves calls, and writes.
"""

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import TypeVar

import bifrost
from valor.common.behaviors import NOTHING_TO_LEAD, ControlMode
from valor.robot.description import RobotDescription
from valor.robot.kinematic_tree import KinematicTree
from valor.valor_ros_controller.control_modes import FILE as MODES
from valor.valor_ros_controller.control_modes import ControlModeTable
from valor.valor_ros_controller.controller_manager import ControllerManager, ControllerSwitch, Resources
from valor.valor_ros_controller.controllers import table as controllers
from valor.valor_ros_controller.controllers.control_mode_controller import ControlModeController
from valor.valor_ros_controller.controllers.joint_trajectory_controller import JointTrajectoryController
from valor.valor_ros_controller.controllers.table import ControllersTable, make_controllers
from valor.valor_ros_controller.controllers.tracking import TrackingController
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface
from valor.valor_ros_controller.valor_escher_interface import BehaviorCommander, ValorEscherInterface

WAIT = 0.02  # longest time between two updates of modes and goals without a Proprioceptor [s]


class Core:
    """All parts, and the update loop.

    Attributes:
        modes: table of control modes.
        table: of controllers.
        hw: state and commands.
        interface: to the Motion System.
        mode_controller: state machine of the control modes.
        trajectories, tracking: controllers by name.
        joints, robots: joint manager and robot manager.
        switch: of controllers by clients. Update thread.
    """

    def __init__(
        self,
        robot: RobotDescription,
        node: bifrost.Node,
        commander: Callable[[Callable[[], None]], BehaviorCommander],
        *,
        decimation: int,
        silence_timeout: float,
        rejection: str = "",
        tree: KinematicTree | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Create all parts; for the arguments see ``ValorEscherInterface``.

        ``rejection``: reason to reject every control mode, empty if there is none; ``tree``: of the robot.

        Raises:
            ConfigurationError: a table is invalid.
            JointClaimError: two controllers of one mode write the same joint.
        """
        everything = ControllersTable.load(_of_robot(robot, controllers.FILE))
        self.table = table = everything.of(robot)
        lacking = "" if table.manipulate else NOTHING_TO_LEAD
        self.modes = modes = ControlModeTable.load(_of_robot(robot, MODES)).without(
            everything.all.keys() - table.all.keys(), lacking
        )
        self.hw = hw = ValorEscherHWInterface(robot)
        self.interface = ValorEscherInterface(node, commander, hw, decimation, silence_timeout, clock=clock)
        self.mode_controller = ControlModeController(modes, self.interface, rejection)
        resources = Resources(hw, modes, tree)
        self._modes = ControllerManager("mode", [self.mode_controller])
        self.joints = ControllerManager("joint", make_controllers(table.joint_controllers, resources))
        self.robots = ControllerManager("robot", make_controllers(table.robot_controllers, resources))
        made = [*self.joints.controllers.values(), *self.robots.controllers.values()]
        self.trajectories = {each.name: each for each in made if isinstance(each, JointTrajectoryController)}
        self.tracking = {each.name: each for each in made if isinstance(each, TrackingController)}
        self.switch = ControllerSwitch((self._modes, self.joints, self.robots), hw)
        self.queue = UpdateQueue()  # calls into the update thread
        self.began = 0.0  # start of the latest cycle, after its data were received [``time.perf_counter()``, s]
        self.cycles = 0  # number of cycles with a measurement
        self._resets = 0
        self._last_time = 0
        self._check_modes()
        self._modes.enter("", [self.mode_controller.name], hw, "start", restart=True)

    def _check_modes(self) -> None:
        """Check that the controllers of each mode exist, and that no two of them write the same joint."""
        for name, mode in self.modes.modes.items():
            self.joints.check(mode.joint_controllers, f"control mode {name}: joint_controllers")
            self.robots.check(mode.robot_controllers, f"control mode {name}: robot_controllers")
            self.robots.check(mode.optional_controllers, f"control mode {name}: optional_controllers")
            trial = ValorEscherHWInterface(self.hw.robot)
            for controller in (*mode.joint_controllers, *mode.robot_controllers):
                if writer := self.trajectories.get(controller):
                    trial.claim(controller, writer.joints)

    @property
    def rejected(self) -> int:
        """Number of rejected messages, control modes and trajectories."""
        trajectories = sum(controller.rejections.count for controller in self.trajectories.values())
        return self.interface.rejected + self.mode_controller.rejections.count + trajectories

    def wait(self) -> bool:
        """Wait for the measurement of the next cycle and store it; returns whether it was received."""
        return self.interface.receive(WAIT)

    def update(self, measured: bool) -> None:
        """Run a cycle; sends set-points if ``measured``, the result of ``wait``."""
        self.interface.poll()
        self.began = time.perf_counter()
        self.cycles += measured
        hw = self.hw
        went_back = hw.time < self._last_time
        self._last_time = hw.time
        self._modes.update(hw)
        self._enter_mode(went_back)
        self.mode_controller.answer()
        self.joints.update(hw)
        self.robots.update(hw)
        self.queue.run()  # after the controllers: a goal received before a query is active
        if measured:
            self.interface.write()
            self.interface.publish_cycle()
        self.interface.report(self.mode_controller.report)

    def _enter_mode(self, went_back: bool) -> None:
        """Activate the controllers of the active mode, none while the Motion System is silent."""
        hw, mode_controller, silent = self.hw, self.mode_controller, self.interface.silent
        name = mode_controller.active_mode
        restart = went_back or mode_controller.hard_resets != self._resets
        self._resets = mode_controller.hard_resets
        if silent or not name:
            hw.situation = reason = f"{silent or 'the Motion System'} is silent"
            self.joints.enter("", (), hw, reason)
            self.robots.enter("", (), hw, reason)
            return
        mode = self.modes.modes[name]
        hw.situation = f"control mode {name}"
        reason = "robot time went back" if went_back else hw.situation
        if name == ControlMode.NONE and self.interface.behavior:
            reason = f"{reason}, the Motion System is in {self.interface.behavior}"
        self.joints.enter(name, mode.joint_controllers, hw, reason, restart=restart)
        optional = mode.optional_controllers
        self.robots.enter(name, mode.robot_controllers, hw, reason, optional=optional, restart=restart)

    def close(self) -> None:
        """Send no more behavior requests. The owner closes the node."""
        self.interface.close()


def _of_robot(robot: RobotDescription, file: Path) -> Path:
    """The robot's own table, a file of the same name in its folder, if there is one."""
    own = robot.folder / file.name
    return own if own.is_file() else file


T = TypeVar("T")

CALL_TIMEOUT = 2.0  # the update loop runs every few milliseconds, also while the robot is silent [s]


class UpdateQueue:
    """Calls from other threads, run between two cycles of the update thread, in order."""

    def __init__(self) -> None:
        self._calls: deque[Callable[[], None]] = deque()

    def call(self, function: Callable[[], T]) -> T:
        """Return the result of a function run in the update thread; from any other thread.

        Raises TimeoutError: the update loop does not run; Exception: of the function.
        """
        future: Future[T] = Future()

        def run() -> None:
            try:
                future.set_result(function())
            except Exception as error:
                future.set_exception(error)

        self._calls.append(run)
        try:
            return future.result(CALL_TIMEOUT)
        except TimeoutError:
            if future.done():
                raise
            raise TimeoutError(f"the update loop did not run within {CALL_TIMEOUT:g} s") from None

    def run(self) -> None:
        """Run waiting calls. Update thread."""
        while self._calls:
            self._calls.popleft()()
