"""The drop-down of controllers: what it offers, who may use it, and what is sent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from std_msgs.msg import String
from valor_msgs.msg import ControllerStatus
from viser import ViserServer

from harness.closed_loop import load_robot
from harness.instance import RunningInstance
from harness.raw_viewer import RawViewer
from harness.waiting import PATIENCE, wait_until
from valor.common.errors import RefusalError
from valor.common.instance import Settings
from valor.operator_station.commands.commander import Commander
from valor.operator_station.commands.queue import COMMAND as LATEST
from valor.operator_station.commands.queue import CommandQueue, UserEvent
from valor.operator_station.robot.intake import Intake
from valor.operator_station.robot.modes import Modes
from valor.operator_station.scene.scene import Scene
from valor.operator_station.tabs import StationContext
from valor.operator_station.tabs.drive import Drive
from valor.operator_station.tabs.status import StatusPanel
from valor.robot.model import full_model
from valor.ros.controllers import COMMAND, STATUS
from valor.ros.node import RosSide


class Station:
    """The tab *Drive* of an operator, Ann, and an onlooker; the robot's topics are said by the test."""

    def __init__(self, instance: RunningInstance) -> None:
        settings = Settings(robot=Path("escher"), ros_domain_id=instance.settings.ros_domain_id)
        self.side = RosSide("station", settings, {}, (), sim_time=False)
        self.sent: list[str] = []
        self.side.node.create_subscription(String, COMMAND, lambda message: self.sent.append(message.data), 1)
        self.intake, self.server = Intake(), ViserServer(host="127.0.0.1", port=0, verbose=False)
        self.desk = CommandQueue("token")
        self.desk.server = self.server
        self.panel = StatusPanel(self.server, self.desk.lease.describe, self.desk.log)
        scene = Scene(self.server, full_model(load_robot(), "all"), None)
        commander = Commander(self.side.node, self.side.executor, [])
        self.server.on_client_connect(self.desk.arrived)
        self.ann, self.onlooker = (RawViewer(self.server.get_port()) for _ in range(2))
        wait_until(lambda: len(self.server.get_clients()) == 2, PATIENCE, "viewers")
        parts = [StationContext(self.server.get_clients()[0], self.desk, commander, self.intake.heard, scene)]
        self.desk.began = lambda client: setattr(self, "drive", Drive(parts[0], Modes()))
        self.desk.claim(UserEvent(0, 0.0, None), "Ann", "token", over=False)
        self.drive: Drive

    def say(self, topic: str, message: Any) -> None:
        next(each for each in self.intake.inputs if each.topic == topic).take(message, 0.0)

    def pick(self, name: str) -> None:
        """Choose it in Ann's browser, which then shows it."""
        self.ann.set("controller", name)
        self.ann.controls[self.ann.labels["controller"]]["props"]["value"] = name

    def wait(self, condition: Callable[[], Any], what: str) -> None:
        def holds() -> bool:
            self.side.executor.spin_once(timeout_sec=0.01)
            self.desk.turn()
            self.drive.draw()
            self.panel.draw(self.intake.heard, 0.0)
            return bool(condition())

        wait_until(holds, PATIENCE, what)

    @property
    def shown(self) -> tuple[Any, ...]:
        """Options of the drop-down in the browser, its value, and whether it is disabled."""
        ann = self.ann
        props = ann.controls[ann.labels["controller"]]["props"] if "controller" in ann.labels else {}
        value = ann.controls[ann.labels["controller"]]["value"] if props else ""
        return tuple(props.get("options", ())), props.get("value", value), props.get("disabled")

    def close(self) -> None:
        for viewer in (self.ann, self.onlooker):
            viewer.socket.close()
        self.server.stop()
        self.side.close()


@pytest.fixture
def station(instance: RunningInstance) -> Iterator[Station]:
    made = Station(instance)
    yield made
    made.close()


def test_the_operator_alone_chooses_among_those_that_the_behavior_allows(station: Station) -> None:
    status = ControllerStatus(active="whole_body", stand=["whole_body", "statue"], walk=["whole_body"])
    station.wait(lambda: station.shown == (("–",), "–", True), "nothing is known")
    station.intake.heard.states = {"behavior": "stand"}
    station.say(STATUS, status)
    station.wait(lambda: station.shown == (("statue", "whole_body"), "whole_body", False), "both are offered")
    uuid = station.ann.labels["controller"]
    station.onlooker.say("GuiUpdateMessage", uuid=uuid, updates={"value": "statue"})
    station.pick("nobody")
    station.wait(lambda: "refused – expected in stand one of statue, whole_body" in log(station), "a refusal")
    station.wait(lambda: station.shown[1] == "whole_body", "the robot's choice is shown again")
    late = UserEvent(0, LATEST + 0.1, SimpleNamespace(target=station.drive._controller))
    with pytest.raises(RefusalError, match="came too late"):
        station.drive._choose(late)
    assert not station.sent
    station.pick("statue")
    station.wait(lambda: station.sent == ["statue"], "the request is sent once")
    taken = ControllerStatus(active="statue", reason="statue after whole_body", stand=["statue", "whole_body"],
                             walk=["whole_body"])  # fmt: skip
    station.say(STATUS, taken)
    station.wait(lambda: station.shown[1] == "statue" and "controller <b>statue</b>" in station.panel._state.content,
                 "what is in control")  # fmt: skip
    assert station.intake.heard.news[0][1] == "controller: statue after whole_body"
    station.intake.heard.states = {"behavior": "walk"}
    station.wait(lambda: station.shown == (("whole_body",), "whole_body", True), "walking has no choice")
    assert station.sent == ["statue"], "what the station itself shows is no command"


def log(station: Station) -> str:
    return "\n".join(command.line() for command in station.desk.log.commands)
