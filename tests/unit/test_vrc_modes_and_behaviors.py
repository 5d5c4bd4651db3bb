"""Whatever is asked, refused, lost or restarted: control mode and behavior agree, or the difference is reported."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from harness.examples import examples
from harness.vrc_in_process import MODES, PATIENCE, PERIOD, ModeClient, System
from valor.common.behaviors import EMERGENCY_STOP, Behavior
from valor.common.messages import BehaviorRequest, ModeStatus
from valor.valor_ros_controller import behavior_transition
from valor.valor_ros_controller.control_modes import ModeReport

S = ModeStatus
STOPPED = (Behavior.SOFT_STOP, Behavior.FREEZE)
REPORT_TIMEOUT = 25  # of an accepted behavior, in these tests [periods]
SETTLED = 2 * (PATIENCE + REPORT_TIMEOUT) + 30  # both commands of a pair late, and one more pair that follows [periods]

REFUSALS = {
    S.MODE_REJECTED | S.ERR_INVALID_BEHAVIOR_MODE,
    S.MODE_REJECTED | S.ERR_INVALID_TRANSITION,
    S.MODE_REJECTED | S.ERR_PRIOR_COMMAND_IN_PROGRESS,
    S.MODE_REJECTED | S.ERR_CONTROLLER_NOT_READY,
    S.MODE_REJECTED | S.EXTERNAL_CHANGE,
}
RESULTS = {S.MODE_ACCEPTED, S.MODE_ACCEPTED | S.MODE_DUPLICATE, S.MODE_PREEMPTED} | REFUSALS
REPORTS = RESULTS | {S.MODE_PROCESSING, S.EXTERNAL_CHANGE, S.EXTERNAL_CHANGE | S.ERR_CONTROLLER_NOT_READY}

names = st.sampled_from([*MODES.modes]).flatmap(lambda name: st.sampled_from([name, name.upper(), f" {name.title()} "]))
unknown = st.sampled_from(["dance", "whole_body", "calibrate", "", "stand prep", "idle", "get_up", "стойка"])


@pytest.fixture(autouse=True, scope="module")
def short_patience() -> Iterator[None]:
    """An accepted behavior must be reported within ``REPORT_TIMEOUT``, so that tests need not wait for seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(behavior_transition, "REPORT_TIMEOUT", REPORT_TIMEOUT * PERIOD * 1e-9)
        yield


class ModesAndBehaviors(RuleBasedStateMachine):
    """Commands from clients and from another commander, losses, delays, stalls, falls and restarts."""

    @initialize()
    def begin(self) -> None:
        self.system = System()
        self.system.after = self.look
        self.clients: list[ModeClient] = []
        self.last = ModeReport("", "none", S.ERR_CONTROLLER_NOT_READY)
        self.system.run(4)

    @property
    def behavior(self) -> Behavior:
        assert self.system.motion is not None
        return self.system.motion.fsm.behavior

    def look(self) -> None:
        """After every cycle: what is reported is one of the cases, and true."""
        vrc = self.system.vrc
        report, heard, previous = vrc.mode_controller.report, vrc.interface.behavior, self.last
        self.last = report
        assert report.status in REPORTS or not heard, report
        assert bool(vrc.mode_controller.active_mode) == bool(heard)
        if not heard:
            assert report.current == "none" and report.status & S.ERR_CONTROLLER_NOT_READY, report
        elif not report.status & S.MODE_PROCESSING:
            assert report.current == "stop" or MODES.fits(report.current, heard), (report, heard)
            assert vrc.mode_controller.active_mode == report.current
        if report.current != previous.current and not report.status & (S.EXTERNAL_CHANGE | S.ERR_CONTROLLER_NOT_READY):
            if report.status & S.MODE_PROCESSING:  # an emergency stop that goes on to another way to stop
                assert report.requested in MODES.emergency_stop, (previous, report)
            elif report.status & S.MODE_ACCEPTED:
                assert report.requested == report.current, (previous, report)
            else:
                assert report.status & S.MODE_REJECTED, (previous, report)

    # --- clients --------------------------------------------------------------------------------------------------

    @rule(name=names, periods=st.integers(0, 30))
    def a_client_asks(self, name: str, periods: int) -> None:
        self.clients.append(self.system.ask(name))
        self.system.run(periods)

    @rule(name=unknown)
    def a_client_asks_for_nonsense(self, name: str) -> None:
        client = self.system.ask(name)
        self.system.run(6, until=lambda: client.result is not None)
        assert client.result is not None
        expected = S.ERR_INVALID_BEHAVIOR_MODE if self.system.vrc.interface.behavior else S.ERR_CONTROLLER_NOT_READY
        assert client.result.status == S.MODE_REJECTED | expected

    @rule()
    def a_client_repeats(self) -> None:
        self.system.run(6)  # what was asked before is under way
        if self.last.status & S.MODE_PROCESSING:
            return
        before, behavior, asked = self.last, self.system.vrc.interface.behavior, self.system.commander.asked
        client = self.system.ask(before.current.upper())
        self.system.run(2)
        if behavior and behavior == self.system.vrc.interface.behavior and client.result:
            assert self.system.commander.asked == asked
            assert client.result == ModeReport(before.current, before.current, S.MODE_ACCEPTED | S.MODE_DUPLICATE)

    @precondition(lambda self: not self.system.frozen and self.healthy)
    @rule(others=st.lists(names, max_size=2))
    def an_emergency_stop(self, others: list[str]) -> None:
        """It wins over whatever is under way."""
        heard = self.system.vrc.interface.behavior
        clients = [self.system.ask(name) for name in others]
        self.system.run(2 * len(others))
        client = self.system.ask(EMERGENCY_STOP.upper())
        self.settle()
        assert client.result is not None
        if heard and not client.result.status & S.ERR_PRIOR_COMMAND_IN_PROGRESS:
            assert self.behavior in STOPPED, (client.result, self.behavior)
        self.clients += clients

    # --- what goes wrong ------------------------------------------------------------------------------------------

    @property
    def healthy(self) -> bool:
        commander = self.system.commander
        return not (commander.lose_requests or commander.lose_replies)

    @rule(periods=st.integers(1, 30))
    def time_passes(self, periods: int) -> None:
        self.system.run(periods)

    @rule(there=st.integers(0, 4), back=st.integers(0, 4))
    def the_network_is_slow(self, there: int, back: int) -> None:
        self.system.commander.delays = (there, back)

    @rule(requests=st.booleans(), replies=st.booleans())
    def the_network_loses(self, requests: bool, replies: bool) -> None:
        self.system.commander.lose_requests, self.system.commander.lose_replies = requests, replies

    @rule(periods=st.integers(1, 40))
    def the_motion_manager_stalls(self, periods: int) -> None:
        self.system.frozen = True
        self.system.run(periods)
        self.system.frozen = False

    @rule()
    def the_motion_manager_restarts(self) -> None:
        self.system.restart_motion_manager()

    @rule()
    def the_vrc_restarts(self) -> None:
        self.system.start_vrc()
        self.clients.clear()  # nobody is left to answer them
        self.last = self.system.vrc.mode_controller.report
        self.system.run(2)
        report = self.system.vrc.mode_controller.report
        if self.system.vrc.interface.behavior:
            assert report.status == S.EXTERNAL_CHANGE

    @rule(behavior=st.sampled_from([Behavior.FALL, Behavior.SOFT_STOP, Behavior.STAND]))
    def the_robot_goes_elsewhere(self, behavior: Behavior) -> None:
        """It falls, its QP fails, its plan is finished."""
        assert self.system.motion is not None
        self.system.motion.go(behavior, "on its own")

    @rule(behavior=st.sampled_from([*Behavior]))
    def another_commander_asks(self, behavior: Behavior) -> None:
        assert self.system.motion is not None
        self.system.motion._behavior.handle(BehaviorRequest(str(behavior)), "another")

    # --- what holds -----------------------------------------------------------------------------------------------

    def settle(self) -> None:
        self.system.run(SETTLED)

    @rule()
    def all_is_quiet(self) -> None:
        """With everything in order again, mode and behavior agree and everybody has been answered."""
        self.system.commander.lose_requests = self.system.commander.lose_replies = False
        self.settle()
        report = self.system.vrc.mode_controller.report
        assert not report.status & S.MODE_PROCESSING, report
        assert report.current == "stop" or MODES.fits(report.current, str(self.behavior)), (report, self.behavior)
        assert all(client.result for client in self.clients)

    @invariant()
    def answers_are_true(self) -> None:
        for client in getattr(self, "clients", ()):
            if (result := client.result) is None:
                continue
            assert result.status in RESULTS, result
            if result.status & S.MODE_ACCEPTED:
                assert result.current == result.requested == client.asked.strip().lower()

    def teardown(self) -> None:
        if hasattr(self, "system"):
            self.all_is_quiet()


ModesAndBehaviors.TestCase.settings = settings(examples(15), stateful_step_count=20)
TestModesAndBehaviors = ModesAndBehaviors.TestCase


# --- what was found in this way -----------------------------------------------------------------------------------


@pytest.fixture
def system() -> System:
    made = System()
    made.run(4)
    for mode in ("stand", "stand_manipulate"):
        client = made.ask(mode)
        made.run(40)
        assert client.result == ModeReport(mode, mode, S.MODE_ACCEPTED)
    return made


def behavior(system: System) -> Behavior:
    assert system.motion is not None
    return system.motion.fsm.behavior


@pytest.mark.parametrize("delay", range(6))
def test_an_emergency_stop_wins_over_a_change_whose_effect_comes_late(system: System, delay: int) -> None:
    """It was given up when the Motion System obeyed the command before it."""
    system.commander.delays = (2, 2)
    change = system.ask("step_manipulate")
    system.run(2 * delay)
    stop = system.ask("Emergency_Stop")
    system.run(SETTLED)
    assert stop.result == ModeReport("soft_stop", "soft_stop", S.MODE_ACCEPTED)
    assert behavior(system) is Behavior.SOFT_STOP
    assert change.result is not None and change.result.status == S.MODE_PREEMPTED


@pytest.mark.parametrize("delay", range(6))
def test_an_emergency_stop_takes_a_soft_stop_back_that_is_being_left(system: System, delay: int) -> None:
    """It was accepted at once, since the mode still was soft_stop, and the robot went on to stand."""
    system.ask("soft_stop")
    system.run(40)
    system.commander.delays = (2, 2)
    system.ask("stand")
    system.run(delay)
    stop = system.ask("emergency_stop")
    system.run(SETTLED)
    assert stop.result is not None and stop.result.current == "soft_stop"
    assert behavior(system) is Behavior.SOFT_STOP


def test_an_emergency_stop_that_is_refused_where_the_robot_has_gone_stops_it_otherwise(system: System) -> None:
    """Soft stop was chosen in stand, and refused in the stand_prep that was about to begin."""
    system.ask("stand")
    system.run(40)
    system.commander.delays = (3, 0)
    system.ask("stand_prep")
    system.run(4)
    stop = system.ask("emergency_stop")
    system.run(SETTLED)
    assert stop.result == ModeReport("freeze", "freeze", S.MODE_ACCEPTED)
    assert behavior(system) is Behavior.FREEZE


def test_what_the_motion_manager_fell_silent_on_is_not_asked_for_when_it_is_back(system: System) -> None:
    """The second command of a change that had been rejected long before was sent all the same."""
    system.commander.delays = (0, 4)
    change = system.ask("step_manipulate")
    system.run(2)
    system.frozen = True
    system.run(PATIENCE - 5, until=lambda: change.result is not None)
    assert change.result is not None and change.result.status == S.MODE_REJECTED | S.ERR_CONTROLLER_NOT_READY
    asked = system.commander.asked
    system.frozen = False
    system.run(SETTLED)
    assert system.commander.asked == asked
    assert system.vrc.mode_controller.report == ModeReport("step_manipulate", str(behavior(system)), S.EXTERNAL_CHANGE)


@pytest.mark.parametrize(
    ("before", "lost", "mode", "current", "status"),
    [
        # A lost reply is no refusal if the robot is where it was asked to go.
        ("stand_manipulate", "lose_replies", "step", "step", S.MODE_ACCEPTED),
        # ``stop`` stands for no behavior: a refused change does not end it.
        ("stop", "lose_requests", "stand", "stop", S.MODE_REJECTED | S.ERR_CONTROLLER_NOT_READY),
    ],
)
def test_what_is_lost(system: System, before: str, lost: str, mode: str, current: str, status: ModeStatus) -> None:
    system.ask(before)
    system.run(4)
    setattr(system.commander, lost, True)
    change = system.ask(mode)
    system.run(SETTLED)
    assert change.result == ModeReport(mode, current, status)


def test_a_stop_that_cannot_follow_does_not_end_the_change_under_way(system: System) -> None:
    """``freeze`` is refused to a robot on one leg; it had put an end to the change all the same."""
    system.ask("step")
    system.run(40)
    change = system.ask("step_manipulate")
    system.run(2)
    stop = system.ask("freeze")
    system.run(SETTLED)
    assert stop.result == ModeReport("freeze", "step", S.MODE_REJECTED | S.ERR_INVALID_TRANSITION)
    assert change.result == ModeReport("step_manipulate", "step_manipulate", S.MODE_ACCEPTED)


def test_an_external_change_is_reported_even_if_something_is_asked_in_the_same_cycle(system: System) -> None:
    """The report of what was asked for came instead of it."""
    reports: list[ModeReport] = []
    system.after = lambda: reports.append(system.vrc.mode_controller.report)
    assert system.motion is not None and system.motion.go(Behavior.FALL, "pushed")
    system.ask("stand_prep")
    system.run(10)
    assert ModeReport("stand_manipulate", "none", S.EXTERNAL_CHANGE) in reports
    assert reports[-1].requested == "stand_prep"
