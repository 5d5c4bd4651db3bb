"""The operator's page: what it shows, and what the robot does when its buttons are pressed."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bifrost
from harness.operator_page import PATIENCE, Page
from harness.system import System
from harness.waiting import wait_until
from tests.integration.held_line import HeldLine
from valor.common.behaviors import Behavior
from valor.common.instance import Instance
from valor.common.messages import MotionState, Proprioceptor
from valor.common.topics import GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR, VELOCITY
from valor.common.viewing import page_port
from valor.operator_station.scene.body import Body
from valor.robot.description import RobotDescription
from valor.robot.model import full_model

pytestmark = pytest.mark.timeout(1800)
LATE = 3.0  # longer than a command may take to come [s]
QUIET = 0.5  # longer than the time between velocities of a held button [s]


class Robot:
    """What the robot does, by its own word, and where it is in truth."""

    def __init__(self, system: System, home: Path) -> None:
        self.system = system
        self.instance = Instance(system.name, home)
        self.description = RobotDescription.load(self.instance.settings().robot)
        network = bifrost.Network.load(self.instance.network_file, self.instance.keys)
        self._node = bifrost.Node("beside_the_page", network=network)
        self._states = MOTION_STATE.subscriber(self._node, queue=20000)
        self._senses = PROPRIOCEPTOR.subscriber(self._node)
        self._velocities = VELOCITY.subscriber(self._node, queue=20000)
        self._told: tuple[int, list[float]] = 0, []  # last velocity: time of arrival [ns], signs
        self._truth = GROUND_TRUTH.subscriber(self._node)
        self._body = Body(full_model(self.description))

    def close(self) -> None:
        self._node.close()

    def behaviors(self) -> set[str]:
        """Since this was asked last."""
        return {received.message.behavior for received in self._states.drain()}

    def state(self) -> MotionState:
        self._states.drain()
        return wait_until(lambda: self._states.receive(timeout=1.0), PATIENCE, "MotionState").message

    def place(self) -> Any:
        """(3,) of the pelvis in truth [m]."""
        truth = wait_until(lambda: self._truth.receive(timeout=1.0), PATIENCE, "truth").message
        return truth.pelvis_position_in_world

    def velocity(self, *signs: int) -> None:
        """Wait until it is told to walk so: forward, left, turning left; or to stand, and then nothing else."""

        def told() -> bool:
            for received in self._velocities.drain():
                command = received.message
                self._told = received.arrived, np.sign((command.linear_x, command.linear_y, command.angular_z)).tolist()
            arrived, last = self._told
            return last == list(signs) and (any(signs) or time.monotonic() - 1e-9 * arrived > QUIET)

        wait_until(told, PATIENCE, f"velocities {signs}")

    def joint(self, name: str) -> float:
        return float(self._sensed().joint_position[self.description.index[name]])

    def _sensed(self) -> Proprioceptor:
        self._senses.drain()
        return wait_until(lambda: self._senses.receive(timeout=1.0), PATIENCE, "Proprioceptor").message

    def left_hand(self) -> tuple[Any, Any]:
        """(3,) and (3, 3) in odom, by the estimated pelvis and the measured joints."""
        hand = self.description.tables.hands.left
        assert hand is not None
        state = self.state()
        self._body.place(state.pelvis_position_in_odom, state.pelvis_orientation_in_odom)
        self._body.pose(self._sensed().joint_position)
        self._body.update()
        return self._body.site(hand.site)

    def kill(self, process: str) -> None:
        """As the kernel would: its supervisor starts it again."""
        (pid,) = (each["pid"] for each in self.system.status()["services"] if each["name"] == process)
        os.kill(pid, signal.SIGKILL)


@pytest.fixture(scope="module")
def robot(browser: Any, system: System) -> Iterator[Robot]:
    robot = Robot(system, Path(system.environment["VALOR_HOME"]))
    yield robot
    robot.close()


@pytest.fixture(scope="module")
def line(robot: Robot) -> Iterator[HeldLine]:
    with HeldLine(page_port(robot.instance.settings())) as line:
        yield line


@pytest.fixture(scope="module")
def page(browser: Any, line: HeldLine, robot: Robot) -> Page:
    page = Page(browser, line.port)
    page.take_control("Ann", robot.instance.operator_token.read_text(), "Ann operates")
    page.dismiss()
    return page


def test_the_page_fetches_nothing_from_other_computers(page: Page) -> None:
    own = re.compile(r"http://(127\.0\.0\.1|localhost):|data:|blob:")
    assert all(own.match(url) for url in page.requests), page.requests


def test_the_robot_stands_up(page: Page, robot: Robot) -> None:
    page.command("stand_prep", "control mode stand_prep", "done")
    page.sees("state", "behavior stand_prep")
    page.command("stand", "control mode stand:", "done")
    page.sees("state", "behavior stand ")
    assert robot.state().behavior == Behavior.STAND


def test_it_shows_what_the_robot_sees(page: Page) -> None:
    said = page.view.get_by_text("The picture is fresh.")
    said.wait_for()
    wide = "() => [...document.images].some((one) => one.naturalWidth === 640 && one.getClientRects().length)"
    page.view.wait_for_function(wide)


def test_a_mode_is_changed_and_those_that_cannot_follow_say_why(page: Page, robot: Robot) -> None:
    page.command("stand_manipulate", "control mode stand_manipulate", "done")
    assert robot.state().behavior == Behavior.STAND_MANIPULATE
    refused = page.button("stand_prep – not from stand_manipulate: first freeze")
    refused.wait_for()
    assert refused.is_disabled()
    robot.behaviors()
    given = page.number()
    refused.dispatch_event("click")  # a browser that ignores `disabled`
    page.command("manipulate", "control mode manipulate", "done")
    assert not page.commanded("stand_prep", "done", given)
    assert robot.behaviors() <= {Behavior.STAND_MANIPULATE}


def test_a_controller_is_chosen_and_why_it_does_not_take_over_is_shown(page: Page, robot: Robot) -> None:
    page.tab("Drive")
    page.select("controller", "remote")
    page.sees("commands", "controller remote")
    page.view.get_by_text("no command on motion_manager/joint_commands yet").first.wait_for()
    wait_until(lambda: page.selected("controller") == "whole_body", PATIENCE, "the controller in use is shown again")
    assert robot.state().behavior == Behavior.STAND_MANIPULATE


def test_an_arm_goes_where_its_ghost_was_when_it_is_approved(page: Page, robot: Robot) -> None:
    name = "l_shoulder_pitch"
    wanted = robot.description.tables.arm_presets["forward"]["left"][name]
    page.tab("Arms")
    before = robot.joint(name)
    page.press("left arm: forward")
    page.view.get_by_text("nothing speaks against it").wait_for()
    assert abs(robot.joint(name) - before) < 0.05, "nothing moves before it is approved"
    page.command("Approve and execute", "left arm forward", "arrived")
    assert abs(robot.joint(name) - wanted) < 0.05


def test_a_hand_is_dragged_shown_approved_and_led_there(page: Page, robot: Robot) -> None:
    before = robot.left_hand()
    page.show_goal("left")
    page.drag("left", *before, 0.3)
    page.view.get_by_text("would be refused: reach: the left hand would stay").wait_for()
    assert page.button("Approve and execute").is_disabled()
    page.press("Forget it")
    page.view.get_by_text("nothing is previewed").wait_for()
    page.show_goal("left", shown=False)
    page.show_goal("left")
    goal = np.array([float(each) for each in re.findall(r"-?\d+\.\d+", page.drag("left", *before, -0.06))])
    page.view.get_by_text("nothing speaks against it").wait_for()
    assert np.linalg.norm(robot.left_hand()[0] - before[0]) < 0.02, "nothing moves before it is approved"
    assert np.linalg.norm(goal - before[0]) > 0.02
    page.command("Approve and execute", "left hand to (", "handed over")
    wait_until(lambda: np.linalg.norm(robot.left_hand()[0] - goal) < 0.015, PATIENCE, "the hand is there")
    page.sees("state", "l hand reached")
    page.show_goal("left", shown=False)


def test_a_click_on_the_floor_is_walked_when_it_is_approved(page: Page, robot: Robot) -> None:
    page.tab("Drive")
    page.command("stand", "control mode stand:", "done")
    page.view.get_by_text("click on the floor to plan").click()
    before, pelvis = robot.place(), robot.state().pelvis_position_in_odom[:2]
    target = pelvis + np.array((-0.2, 0.6))  # away from the stairs
    page.page.mouse.click(*page.at((*target, 0.0)))
    text = page.view.get_by_text("steps to (").inner_text()
    goal = np.array([float(each) for each in re.findall(r"-?\d+\.\d+", text)][:2])
    assert np.linalg.norm(robot.place() - before) < 0.05, "nothing moves before it is approved"
    page.command("Walk there", "steps:", "all steps taken")
    way = robot.place() - before
    assert np.abs(goal - target).max() < 0.1
    assert np.abs(way[:2] - (goal - pelvis)).max() < 0.1
    page.sees("state", "behavior stand ")


def test_what_was_pressed_during_a_cut_is_late_and_moves_nothing(page: Page, line: HeldLine, robot: Robot) -> None:
    robot.behaviors()
    line.hold()
    page.press("stand_manipulate")
    page.page.wait_for_timeout(1000.0 * LATE)
    line.release()
    page.wait("commands", lambda text: "stand_manipulate: refused – came too late" in text, "late")
    page.sees("state", "fresh")
    assert robot.behaviors() == {Behavior.STAND}


def test_after_a_reload_the_same_browser_operates(page: Page, robot: Robot) -> None:
    robot.behaviors()
    page.page.reload()
    page.arrive()
    page.wait("state", lambda text: "Ann operates" in text and "gone" not in text, "the operator is back")
    page.command("stand_manipulate", "control mode stand_manipulate", "done")
    assert robot.behaviors() <= {Behavior.STAND, Behavior.STAND_MANIPULATE}


def test_the_page_recovers_from_a_killed_vrc_by_itself(page: Page, robot: Robot) -> None:
    robot.behaviors()
    robot.kill("valor_ros_controller")
    page.wait("state", lambda text: re.search(r"joints [\d.]+ s old", text) is not None, "what is old is said to be")
    page.wait("state", lambda text: "joints fresh" in text and "stand_manipulate" in text, "it is heard again")
    assert "Ann operates" in page.text("state")
    assert robot.behaviors() == {Behavior.STAND_MANIPULATE}, "the robot does what it did"
    page.command("stand", "control mode stand:", "done")


@pytest.mark.parametrize("focus", ["page", "view"])
def test_the_walking_pad_is_held_by_its_keys_wherever_the_focus_is(page: Page, robot: Robot, focus: str) -> None:
    page.command("walk", "control mode walk:", "done")
    beside_stop, in_view, still = (700.0, 20.0), (550.0, 300.0), (0, 0, 0)
    here, there = (beside_stop, in_view) if focus == "page" else (in_view, beside_stop)
    page.page.mouse.click(*here)
    assert page.view.evaluate("document.hasFocus()") is (focus == "view")
    keys = {"ArrowUp": (1, 0, 0), "KeyS": (-1, 0, 0), "ArrowLeft": (0, 0, 1), "KeyE": (0, 0, -1), "KeyA": (0, 1, 0),
            "KeyD": (0, -1, 0)}  # fmt: skip
    for key, signs in keys.items():
        page.page.keyboard.down(key)
        robot.velocity(*signs)
        page.page.keyboard.up(key)
        robot.velocity(*still)
    page.page.keyboard.down("KeyW")
    robot.velocity(1, 0, 0)
    page.page.mouse.click(*there)  # it loses the focus
    robot.velocity(*still)
    page.page.keyboard.up("KeyW")
    page.command("stand", "control mode stand:", "done")


def test_the_stop_stops_a_robot_that_walks(page: Page, robot: Robot) -> None:
    page.command("walk", "control mode walk:", "done")
    robot.behaviors()
    page.stop()
    page.said("confirmed: stopped after")
    page.sees("state", "behavior soft_stop")
    assert robot.state().behavior == Behavior.SOFT_STOP
    page.command("stand", "control mode stand:", "done")


def test_a_station_that_was_killed_comes_back_without_an_operator(page: Page, robot: Robot) -> None:
    robot.kill("operator_station")
    page.sees("state", "nobody operates")
    assert robot.state().behavior == Behavior.STAND
