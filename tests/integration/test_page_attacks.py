"""Viewers that attack the page in viser's own protocol: nothing moves, the operator goes on, STOP answers."""

from __future__ import annotations

import dataclasses
import http.client
import json
import math
import random
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from typing import Any

import msgspec
import pytest
from viser import _messages
from websockets.exceptions import ConnectionClosed, InvalidStatus

from harness.instance import RunningInstance
from harness.raw_viewer import RawViewer
from harness.waiting import wait_until
from valor.common.arrays import FloatArray
from valor.common.topics import MOTION_STATE, VELOCITY
from valor.common.viewing import page_port, scene_port
from valor.operator_station.gate import VIEWERS
from valor.operator_station.tabs.drive import FASTEST
from valor.robot.description import RobotDescription

pytestmark = pytest.mark.timeout(600)
TOKEN, PATIENCE = "seven", 120.0
WRONG: tuple[Any, ...] = (
    1e6,
    -1e6,
    math.nan,
    math.inf,
    "nan",
    "1e999",
    -1,
    2**63,
    None,
    [],
    {},
    [math.nan] * 3,
    b"x",
    "x" * 3000,
    True,
)
ATTRIBUTES = (
    "value",
    "props",
    "update_cb",
    "removed",
    "disabled",
    "visible",
    "uuid",
    "gui_api",
    "sync_cb",
    "__class__",
)


class Page:
    """The robot with its page; ``ann`` operates."""

    def __init__(self, instance: RunningInstance) -> None:
        self.instance = instance
        self.port, self.stop_port = scene_port(instance.settings), page_port(instance.settings)
        robot = RobotDescription.load(instance.settings.robot)
        self.arm_joints = [index for side in ("left", "right") for index in robot.group_indices(f"{side}_arm")]
        node = instance.node()
        self.states = MOTION_STATE.subscriber(node, queue=50_000)
        self.velocities = VELOCITY.subscriber(node, queue=50_000)
        self.ann = self.viewer()
        self.ann.set("name", "Ann")
        self.ann.set("token", TOKEN)
        self.ann.set("Take control", True)
        wait_until(lambda: "Preview the neck" in self.ann.labels, PATIENCE, "the operator's controls")

    def viewer(self) -> RawViewer:
        viewer = RawViewer(self.port)
        wait_until(lambda: "Give back" in viewer.labels, PATIENCE, "the viewer's panel")
        return viewer

    def mode(self, name: str) -> None:
        """Press a mode's button as Ann until the robot is in it."""
        pressed = 0.0

        def reached() -> bool:
            nonlocal pressed
            if name in self.ann.labels and time.monotonic() > pressed + 5.0:
                self.ann.set(name, True)
                pressed = time.monotonic()
            received = self.states.latest()
            return received is not None and received.message.behavior == name

        wait_until(reached, PATIENCE, name)

    def behaviors(self) -> set[str]:
        """Since this was asked last."""
        return {received.message.behavior for received in self.states.drain()}

    def arms(self) -> FloatArray:
        """Set-points of both arms [rad]."""
        self.states.drain()
        state = wait_until(lambda: self.states.receive(timeout=1.0), PATIENCE, "MotionState").message
        return state.joint_setpoint[self.arm_joints]

    def request(self, method: str, path: str, port: int, **headers: str) -> tuple[int, bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30.0)
        connection.request(method, path, headers=headers)
        response = connection.getresponse()
        return response.status, response.read()


@pytest.fixture(scope="module")
def page(module_instance: RunningInstance) -> Iterator[Page]:
    module_instance.instance.operator_token.write_text(TOKEN)
    names = ("comms_manager", "motion_manager", "valor_ros_controller", "operator_stop", "operator_station")
    for name in names:
        module_instance.start(name)
    for name in names:
        module_instance.wait_ready(name, PATIENCE)
    page = Page(module_instance)
    page.mode("stand")
    yield page
    page.ann.socket.close()


@pytest.mark.parametrize("headers", [
    {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Host": "evil.example"}, {"Host": "127.0.0.1:1"},
])  # fmt: skip
def test_other_origins_and_names_are_rejected(page: Page, headers: dict[str, str]) -> None:
    for method, path, port in (("GET", "/", page.port), ("GET", "/state", page.stop_port),
                               ("POST", "/stop", page.stop_port)):  # fmt: skip
        assert page.request(method, path, port, **headers)[0] == 403, (method, path)
    if "Origin" in headers:
        with pytest.raises(InvalidStatus, match="403"):
            RawViewer(page.port, headers["Origin"])
    assert page.request("GET", "/?websocket=ws://evil.example", page.port)[0] == 403


def test_controls_that_command_exist_for_the_operator_alone(page: Page) -> None:
    bob = page.viewer()
    assert not {"stand", "walk", "forward", "speed", "Approve and execute", "Walk there"} & set(bob.labels)
    bob.set("token", TOKEN)
    bob.set("Take over", True)
    wait_until(lambda: "walk" in bob.labels and "walk" not in page.ann.labels, PATIENCE, "controls follow the lease")
    page.ann.set("token", TOKEN)
    page.ann.set("Take over", True)
    wait_until(lambda: "Preview the neck" in page.ann.labels and "walk" not in bob.labels, PATIENCE, "and come back")
    bob.socket.close()


def test_an_approval_of_what_was_replaced_is_ignored(page: Page) -> None:
    """A press of "Approve" that is on its way while another preview replaces the one that it approves."""
    page.mode("stand_manipulate")
    page.ann.set("left arm: forward", True)
    wait_until(lambda: not page.ann.approval()["disabled"], PATIENCE, "the preview")
    approval = page.ann.labels["Approve and execute"]
    page.ann.set("right arm: forward", True)
    wait_until(lambda: page.ann.labels["Approve and execute"] != approval, PATIENCE, "another button")
    before = page.arms()
    for _ in range(3):
        page.ann.say("GuiUpdateMessage", uuid=approval, updates={"value": True})
    until = time.monotonic() + 2.0
    wait_until(lambda: time.monotonic() > until, PATIENCE, "nothing")
    assert abs(page.arms() - before).max() < 0.01
    page.ann.set("Forget it", True)
    page.mode("stand")


def test_a_viewer_can_send_anything_and_nothing_moves(page: Page) -> None:
    chance = random.Random(1)
    kinds = [kind for kind in vars(_messages).values() if isinstance(kind, type) and dataclasses.is_dataclass(kind)]
    owned = list(page.ann.controls)
    page.behaviors(), page.velocities.drain()
    with suppress(ConnectionClosed), page.viewer() as bob:  # paced, so that no message is dropped for its rate
        for uuid in owned:
            for frequency in (10.0, 0.0):
                bob.say("GuiButtonHoldMessage", uuid=uuid, frequency=frequency)
            bob.say("GuiUpdateMessage", uuid=uuid, updates={"value": True})
            time.sleep(0.02)
    for _ in range(8):
        with suppress(ConnectionClosed, OSError), page.viewer() as bob:
            own = [*owned, *bob.controls]
            while True:  # until it is disconnected
                kind = chance.choice(kinds)
                fields = {field.name: chance.choice(WRONG) for field in dataclasses.fields(kind)}
                message = {"type": kind.__name__} | fields
                if chance.random() < 0.5:
                    updates = {chance.choice(ATTRIBUTES): chance.choice(WRONG)}
                    message = {"type": "GuiUpdateMessage", "uuid": chance.choice(own), "updates": updates}
                data = msgspec.msgpack.encode(message)
                bob.send(data if chance.random() < 0.8 else data[: chance.randrange(len(data))] + chance.randbytes(4))
    assert page.behaviors() == {"stand"} and not page.velocities.drain()
    page.mode("stand_manipulate")
    page.mode("stand")


def test_the_operators_own_values_are_clamped(page: Page) -> None:
    page.mode("walk")
    page.velocities.drain()
    for speed in WRONG:
        with suppress(ConnectionClosed):
            page.ann.set("speed", speed)
        page.ann.say("GuiButtonHoldMessage", uuid=page.ann.labels["forward"], frequency=10.0)
        time.sleep(0.1)
    told = [received.message for received in page.velocities.drain()]
    assert told, "the operator walks"
    sent = [(command.linear_x, command.linear_y, command.angular_z) for command in told]
    assert all(0.0 <= forward <= FASTEST[0] and left == turn == 0.0 for forward, left, turn in sent), sent
    page.mode("stand")


def test_floods_and_idle_connections_delay_neither_operator_nor_stop(page: Page) -> None:
    with ExitStack() as stack:
        for _ in range(200):
            stack.enter_context(socket.create_connection(("127.0.0.1", page.stop_port)))
            with suppress(ConnectionClosed, OSError):
                stack.enter_context(RawViewer(page.port, speaks=False))
        flood = stack.enter_context(page.viewer())
        with suppress(ConnectionClosed, OSError):
            for _ in range(10_000):
                flood.say("GuiButtonHoldMessage", uuid=page.ann.labels["walk"], frequency=10.0)
        assert flood.ended.wait(PATIENCE), "the flood is cut"
        page.mode("stand_manipulate")
        assert not page.ann.ended.is_set(), f"of {VIEWERS} viewers the operator stays"
        began = time.monotonic()
        status, body = page.request("POST", "/stop", page.stop_port)
        assert status == 200 and time.monotonic() - began < 1.0
    wait_until(
        lambda: json.loads(page.request("GET", "/state", page.stop_port)[1])["stop"]["confirmed"], 10.0, body.decode()
    )
    page.mode("stand")
    assert page.instance.process("operator_station").poll() is None
    assert "a frame failed" not in page.instance.log("operator_station")
