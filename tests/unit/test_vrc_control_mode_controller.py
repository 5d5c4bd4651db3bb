"""The control mode controller against the Motion Manager's own state machine."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

import pytest

from harness.places import ROBOTS
from harness.vrc_in_process import ModeClient
from valor.common.behaviors import Behavior
from valor.common.messages import ModeStatus
from valor.motion_manager.behavior_fsm import BehaviorFsm, Conditions
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.behavior_transition import (
    REPORT_TIMEOUT,
    RETRY_PERIOD,
    WAIT,
    BehaviorAnswer,
    BehaviorTransition,
    TransitionState,
)
from valor.valor_ros_controller.control_modes import ControlModeTable, ModeReport
from valor.valor_ros_controller.controllers.control_mode_controller import ControlModeController
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

S = ModeStatus
TABLE = ControlModeTable.load()
ROBOT = RobotDescription.load(ROBOTS / "escher")


class Plant:
    """A Motion Manager's state machine behind the interface's transitions; a message takes one cycle each way."""

    def __init__(self) -> None:
        self.fsm = BehaviorFsm()
        self.fsm.go(Behavior.STAND_PREP, "start")
        self.behavior = ""
        self.behavior_reason = ""
        self.silent = "motion_manager"
        self.deaf = False
        self.asked: list[str] = []
        self.now = 0.0
        self.conditions = Conditions()  # what the Motion System has against some requests
        self._transition: BehaviorTransition | None = None
        self._number = 1
        self._answer: BehaviorAnswer | None = None
        self.controller = ControlModeController(TABLE, self)  # type: ignore[arg-type]
        self._hw = ValorEscherHWInterface(ROBOT)

    def begin_transition(self, commands: tuple[str, str]) -> BehaviorTransition:
        self._transition = BehaviorTransition(commands, self._number, self.behavior, self._transition)
        self._number += 2
        return self._transition

    def freeze(self, limbs: list[str]) -> Future[BehaviorAnswer]:
        future = Future[BehaviorAnswer]()
        future.set_result(BehaviorAnswer(0, "left_leg" not in limbs, "the legs carry the robot"))
        return future

    def wake(self) -> None: ...

    def cycle(self, count: int = 1) -> None:
        for _ in range(count):
            self.now += 0.004
            self.behavior, self.behavior_reason, self.silent = str(self.fsm.behavior), self.fsm.reason, ""
            answer, self._answer = self._answer, None
            if self._transition:
                command = self._transition.update(self.now, self.behavior, self.behavior_reason, answer)
                if command and not self.deaf:
                    self.asked.append(command[1])
                    verdict = self.fsm.request(Behavior(command[1]), self.conditions, "test")
                    self._answer = BehaviorAnswer(
                        command[0], verdict.accepted, verdict.reason, obstacle=verdict.obstacle
                    )
            self.controller.update(self._hw)
            self.controller.answer()

    def ask(self, mode: str, cycles: int = 12) -> ModeReport:
        client = ModeClient(mode)
        self.controller.request(mode, client)
        self.cycle(cycles)
        assert client.result is not None, f"{mode}: no result"
        assert client.result == self.controller.report or client.report.status & S.MODE_REJECTED
        return client.result


@pytest.fixture
def plant() -> Plant:
    made = Plant()
    made.cycle()
    return made


def test_a_mode_is_reached_by_two_commands(plant: Plant) -> None:
    assert plant.ask("stand") == ModeReport("stand", "stand", S.MODE_ACCEPTED)
    assert plant.ask("Stand_Manipulate") == ModeReport("stand_manipulate", "stand_manipulate", S.MODE_ACCEPTED)
    assert plant.asked == ["stand", "stand", "stand", "stand_manipulate"]


def test_limbs_are_frozen_in_the_mode_that_stays(plant: Plant) -> None:
    plant.ask("stand")
    assert plant.ask("Freeze left_arm neck") == ModeReport("Freeze left_arm neck", "stand", S.MODE_ACCEPTED)
    refused = plant.ask("freeze left_leg")
    assert refused == ModeReport("freeze left_leg", "stand", S.MODE_REJECTED | S.ERR_INVALID_BEHAVIOR_MODE)
    assert plant.controller.rejections.last == "freeze left_leg: the legs carry the robot"


def test_what_passes_by_itself_is_waited_for_and_not_refused(plant: Plant) -> None:
    """A client that asks for stand as soon as it is told of stand_prep gets it; stop, then freeze behind a step."""
    for mode, condition, behavior in (("stand", "not_prepared", "stand"), ("freeze", "stepping", "freeze")):
        plant.conditions = Conditions(**{condition: "2 s to go"})
        client = ModeClient(mode)
        plant.controller.request(mode, client)
        plant.cycle(200)
        assert client.result is None and client.seen[-1].status == S.MODE_PROCESSING
        assert len(plant.asked) < 200 * 0.004 / RETRY_PERIOD + 4, "asked for without pause"
        other = plant.ask("stand_manipulate", cycles=3)
        assert other.status == S.MODE_REJECTED | S.ERR_PRIOR_COMMAND_IN_PROGRESS
        assert f"the change to {mode} is in progress" in plant.controller.rejections.last
        assert "allowed now: " in plant.controller.rejections.last
        plant.conditions = Conditions()
        plant.cycle(60)
        assert client.report == ModeReport(mode, mode, S.MODE_ACCEPTED) and plant.fsm.behavior == behavior
        plant.asked.clear()


def test_what_never_passes_is_refused_in_the_end_and_says_how_long_it_was_waited_for(plant: Plant) -> None:
    plant.conditions = Conditions(not_prepared="stand_prep has not settled: joint 'l_elbow' moves")
    result = plant.ask("stand", cycles=round((WAIT + 2.0) / 0.004))
    assert result == ModeReport("stand", "stand_prep", S.MODE_REJECTED | S.ERR_CONTROLLER_NOT_READY)
    assert f"joint 'l_elbow' moves; not resolved within {WAIT:g} s" in plant.controller.rejections.last


def test_what_the_robot_is_not_fit_for_is_refused_at_once_with_the_reason(plant: Plant) -> None:
    plant.conditions = Conditions(not_loaded="the left foot carries 0 N")
    result = plant.ask("stand")
    assert result == ModeReport("stand", "stand_prep", S.MODE_REJECTED | S.ERR_CONTROLLER_NOT_READY)
    assert plant.controller.active_mode == "stand_prep"
    assert "the left foot carries 0 N" in plant.controller.rejections.drain()[-1][0]


def test_from_stop_the_modes_may_follow_that_may_follow_what_the_robot_does(plant: Plant) -> None:
    plant.ask("stand")
    plant.ask("walk")
    assert plant.ask("stop") == ModeReport("stop", "stop", S.MODE_ACCEPTED)
    asked = list(plant.asked)
    result = plant.ask("freeze")
    assert result == ModeReport("freeze", "stop", S.MODE_REJECTED | S.ERR_INVALID_TRANSITION)
    assert "not allowed from stop in behavior walk; from there: soft_stop, stand, stand_manipulate" in (
        plant.controller.rejections.last
    )
    assert plant.asked == asked
    assert plant.ask("stand").status == S.MODE_ACCEPTED
    plant.ask("stop")
    assert plant.ask("freeze") == ModeReport("freeze", "freeze", S.MODE_ACCEPTED)


def test_a_name_of_any_length_is_repeated_in_part(plant: Plant) -> None:
    result = plant.ask("x" * 200_000)
    assert result.status == S.MODE_REJECTED | S.ERR_INVALID_BEHAVIOR_MODE
    assert len(result.requested) == len(plant.controller.report.requested) == 65
    assert len(plant.controller.rejections.last) < 1000


def test_manipulate_and_stand_manipulate_are_one_behavior_and_the_mode_is_remembered(plant: Plant) -> None:
    plant.ask("stand_manipulate")
    asked = len(plant.asked)
    assert plant.ask("manipulate").current == "manipulate"
    assert len(plant.asked) == asked, "the arms were slaved in between for nothing"
    plant.cycle(5)
    assert plant.controller.current == "manipulate"


def test_a_second_request_meanwhile_is_refused_but_a_soft_stop_preempts(plant: Plant) -> None:
    plant.ask("stand")
    plant.deaf = True
    first, second, third = ModeClient(), ModeClient(), ModeClient()
    plant.controller.request("step", first)
    plant.cycle(2)
    plant.controller.request("walk", second)
    plant.cycle()
    assert second.report.status == S.MODE_REJECTED | S.ERR_PRIOR_COMMAND_IN_PROGRESS
    plant.deaf = False
    plant.controller.request("soft_stop", third)
    plant.cycle(12)
    assert first.report.status == S.MODE_PREEMPTED
    assert third.result == ModeReport("soft_stop", "soft_stop", S.MODE_ACCEPTED)


@pytest.mark.parametrize("mode", ["stand", "stand_manipulate", "step", "step_manipulate", "walk", "walk_manipulate"])
def test_a_fall_is_reported_in_the_cycle_that_hears_of_it(plant: Plant, mode: str) -> None:
    plant.ask("stand")
    if mode != "stand":
        plant.ask(mode)
    resets = plant.controller.hard_resets
    plant.fsm.go(Behavior.FALL, "tilted by 0.7 rad")
    plant.cycle()
    assert plant.controller.report == ModeReport(mode, "none", S.EXTERNAL_CHANGE)
    assert plant.controller.active_mode == "none" and plant.controller.hard_resets == resets + 1


def test_a_fall_during_a_change_ends_the_change(plant: Plant) -> None:
    plant.ask("stand")
    plant.deaf = True
    client = ModeClient()
    plant.controller.request("stand_manipulate", client)
    plant.cycle(3)
    plant.fsm.go(Behavior.FALL, "lost")
    plant.cycle()
    assert client.result == ModeReport("stand_manipulate", "none", S.MODE_REJECTED | S.EXTERNAL_CHANGE)


@pytest.mark.parametrize(("mode", "reason"), [("walk_manipulate", "requested by somebody"), ("step", "plan done")])
def test_the_robot_stays_in_stand_without_arms_or_if_another_client_asked_for_it(
    plant: Plant, mode: str, reason: str
) -> None:
    plant.ask("stand")
    plant.ask(mode)
    plant.fsm.go(Behavior.STAND, reason)
    plant.cycle(12)
    assert plant.controller.report == ModeReport(mode, "stand", S.EXTERNAL_CHANGE)
    assert plant.fsm.behavior is Behavior.STAND


@pytest.mark.parametrize("mode", ["step_manipulate", "walk_manipulate"])
def test_when_a_plan_is_done_the_arms_are_asked_for_again(plant: Plant, mode: str) -> None:
    plant.ask("stand")
    plant.ask(mode)
    reports: list[Any] = []
    plant.fsm.go(Behavior.STAND, "plan done")
    for _ in range(12):
        plant.cycle()
        if not reports or plant.controller.report != reports[-1]:
            reports.append(plant.controller.report)
    assert reports[0] == ModeReport(mode, "stand", S.EXTERNAL_CHANGE)
    assert reports[1].status == S.MODE_PROCESSING and reports[1].current == "stand"
    assert reports[-1] == ModeReport("stand_manipulate", "stand_manipulate", S.MODE_ACCEPTED)
    assert plant.fsm.behavior is Behavior.STAND_MANIPULATE


def test_a_behavior_that_is_accepted_but_never_reported_times_out(plant: Plant) -> None:
    transition = BehaviorTransition(("stand", "stand"), 7, "stand_prep")
    assert transition.update(0.0, "stand_prep", "", None) == (7, "stand")
    assert transition.update(0.1, "stand_prep", "", BehaviorAnswer(6, False, "of another transition")) is None
    assert transition.update(0.2, "stand_prep", "", BehaviorAnswer(7, True, "")) is None
    transition.update(0.2 + REPORT_TIMEOUT, "stand_prep", "", None)
    assert transition.state is TransitionState.PROCESSING
    transition.update(0.3 + REPORT_TIMEOUT, "stand_prep", "", None)
    assert transition.state is TransitionState.FAILED and "still reports stand_prep" in transition.reason


@pytest.mark.parametrize(
    ("mode", "stop"),
    [("stand_prep", "freeze"), ("stand", "soft_stop"), ("walk", "soft_stop"), ("step_manipulate", "soft_stop")],
)
def test_emergency_stop_keeps_the_balance_where_there_is_one(plant: Plant, mode: str, stop: str) -> None:
    if mode != "stand_prep":
        plant.ask("stand")
        plant.ask(mode)
    result = plant.ask("EMERGENCY_STOP")
    assert result == ModeReport(stop, stop, S.MODE_ACCEPTED)


def test_stop_resets_the_controllers_and_leaves_the_behavior(plant: Plant) -> None:
    plant.ask("stand_manipulate")
    asked, resets = list(plant.asked), plant.controller.hard_resets
    assert plant.ask("stop") == ModeReport("stop", "stop", S.MODE_ACCEPTED)
    assert plant.asked == asked and plant.controller.hard_resets == resets + 1
    assert plant.fsm.behavior is Behavior.STAND_MANIPULATE
    assert plant.ask("stand") == ModeReport("stand", "stand", S.MODE_ACCEPTED)
