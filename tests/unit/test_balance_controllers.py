"""Clients choose the controller of a balancing robot: ``valorctl controller``, ROS' services and topics."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from controller_manager_msgs.srv import ListControllers, SwitchController
from rclpy.qos import DurabilityPolicy, QoSProfile
from valor_msgs.msg import ControllerStatus

from harness.closed_loop import load_robot
from harness.instance import RunningInstance
from harness.robot_in_process import RobotInProcess
from harness.waiting import PATIENCE, wait_until
from tests.unit.controllers import SPOILED, Spoiled, Statue
from valor.common.errors import ValorError
from valor.common.instance import Settings
from valor.common.messages import BehaviorChange
from valor.common.topics import BEHAVIOR_CHANGE, CONTROLLER, CONTROLLERS
from valor.motion_manager.handlers.controller import ControllerHandler
from valor.robot.motion_tables import WHOLE_BODY
from valor.ros.controllers import STATUS
from valor.ros.node import RosSide
from valor.valor_ros_controller.ros.balance_controllers import NAMESPACE, BalanceControllers
from valor.valor_ros_controller.ros.node import CommandNode
from valor.valorctl.drive import controller_choice

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STRICT = SwitchController.Request.STRICT


class Balancing:
    """ESCHER in Stand with its Motion Manager, which serves requests for controllers between its periods."""

    def __init__(self, instance: RunningInstance) -> None:
        robot = load_robot(controllers={"stand": [WHOLE_BODY, "statue", "spoiled"], "walk": [WHOLE_BODY, "statue"]})
        spoil = SPOILED["not a number"][0]
        others = [lambda description, _: Statue(description), lambda description, _: Spoiled(description, spoil, 0.0)]
        self._robot = RobotInProcess(robot, "hardware", 1, others=others)
        assert not self._robot.stand_up()
        node = instance.node("motion_manager")
        self._statuses, self._changes = CONTROLLERS.publisher(node), BEHAVIOR_CHANGE.publisher(node)
        self._server = CONTROLLER.server(node, ControllerHandler(self._robot.manager.components).handle)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    @property
    def behavior(self) -> str:
        return self._robot.behavior

    @property
    def active(self) -> str:
        return self._robot.manager.components.exchange.active.name

    def _run(self) -> None:
        exchange, changes, behavior = self._robot.manager.components.exchange, -1, ""
        while not self._over.is_set():
            self._server.serve()
            self._robot.step()
            if exchange.changes != changes:
                changes = exchange.changes
                self._statuses.publish(exchange.status(self._robot.manager.time))
            if self.behavior != behavior:
                behavior = self.behavior
                self._changes.publish(BehaviorChange(0, behavior, "test"))

    def close(self) -> None:
        self._over.set()
        self._thread.join()


@pytest.fixture
def robot(instance: RunningInstance) -> Iterator[Balancing]:
    balancing = Balancing(instance)
    assert CONTROLLER.client(instance.node("observer")).wait_for_server(PATIENCE)
    yield balancing
    balancing.close()


def test_valorctl_changes_the_controller_or_says_why_not(instance: RunningInstance, robot: Balancing) -> None:
    change = partial(controller_choice.change, instance.instance, check=lambda: None)
    values, text = change("statue")
    assert values["reached"] and "statue in control" in text and robot.active == "statue"
    seen = controller_choice.report(instance.instance).as_json()
    assert seen["in_control"] == seen["stand"]["chosen"] == seen["walk"]["chosen"] == "statue"
    assert seen["stand"]["allowed"] == ["spoiled", "statue", WHOLE_BODY] and seen["behavior"] == "stand"
    with pytest.raises(ValorError, match=r"'nobody'.*expected .*spoiled.*see `valorctl controller --instance"):
        change("nobody")
    assert change(WHOLE_BODY)[0]["reached"] and robot.active == WHOLE_BODY
    with pytest.raises(ValorError, match=r"spoiled rejected: spoiled does not take over: .* is not finite"):
        change("spoiled")


class Ros:
    """The VRC's interfaces, and a client of them; callbacks run while it waits."""

    def __init__(self, instance: RunningInstance, robot: Balancing, rejection: str = "") -> None:
        settings = Settings(robot=Path("escher"), ros_domain_id=instance.settings.ros_domain_id)
        self.side = RosSide("vrc", settings, {}, (), node=partial(CommandNode, others=False))
        node = self.side.node
        vrc, behavior = instance.node("valor_ros_controller"), lambda: robot.behavior
        self.served = BalanceControllers(node, vrc, behavior, rate=500.0, rejection=rejection)
        self.statuses: list[Any] = []
        node.create_subscription(ControllerStatus, STATUS, self.statuses.append, LATCHED)
        self._lists = node.create_client(ListControllers, f"/{NAMESPACE}/list_controllers")
        self._switches = node.create_client(SwitchController, f"/{NAMESPACE}/switch_controller")
        self.wait(lambda: self.statuses and self._lists.service_is_ready() and self._switches.service_is_ready())

    def wait(self, condition: Any) -> None:
        def holds() -> bool:
            self.side.executor.spin_once(timeout_sec=0.01)
            return bool(condition())

        wait_until(holds, PATIENCE, "an answer")

    def states(self) -> dict[str, str]:
        future = self._lists.call_async(ListControllers.Request())
        self.wait(future.done)
        assert {each.type for each in future.result().controller} == {"valor/BalanceController"}
        return {each.name: each.state for each in future.result().controller}

    def begin(self, activate: list[str], deactivate: tuple[str, ...] = ()) -> Any:
        request = SwitchController.Request(
            activate_controllers=activate, deactivate_controllers=list(deactivate), strictness=STRICT
        )
        return self._switches.call_async(request)

    def switch(self, activate: list[str], *deactivate: str) -> str:
        """Reason why not; empty if it is done."""
        future = self.begin(activate, deactivate)
        self.wait(future.done)
        assert future.result().ok is not bool(future.result().message)
        return str(future.result().message)

    def close(self) -> None:
        self.side.close()
        self.served.close()


def test_ros_lists_and_switches_the_controllers(instance: RunningInstance, robot: Balancing) -> None:
    ros = Ros(instance, robot)
    try:
        assert ros.states() == {WHOLE_BODY: "active", "statue": "inactive", "spoiled": "inactive"}
        first, second = ros.begin(["statue"]), ros.begin(["spoiled"])
        ros.wait(second.done)
        assert not first.done() and "in progress" in second.result().message, "others are served meanwhile"
        ros.wait(first.done)
        assert first.result().ok and robot.active == "statue"
        ros.wait(lambda: ros.states() == {WHOLE_BODY: "inactive", "statue": "active", "spoiled": "inactive"})
        assert "not active; expected statue" in ros.switch([WHOLE_BODY], WHOLE_BODY)
        assert "expected one of spoiled, statue, whole_body" in ros.switch(["nobody"])
        assert "activate 2 controllers" in ros.switch([WHOLE_BODY, "spoiled"])
        assert robot.active == "statue" and not ros.switch([WHOLE_BODY], "statue")
        assert "is not finite" in ros.switch(["spoiled"])
        ros.served.choose("statue")
        ros.wait(lambda: ros.statuses[-1].active == "statue")
    finally:
        ros.close()


def test_commands_of_ros_are_rejected_if_the_instance_does_not_accept_them(
    instance: RunningInstance, robot: Balancing
) -> None:
    ros = Ros(instance, robot, rejection="ROS commands are off")
    try:
        assert ros.switch(["statue"]) == "ROS commands are off" and robot.active == WHOLE_BODY
    finally:
        ros.close()
