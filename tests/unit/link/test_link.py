"""Both ends over an emulated link in simulated time: nothing late is obeyed, nothing twice; ages are not flattered."""

import random
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.emulated_channel import DRC_FAST, DRC_SLOW, Conditions, random_windows
from harness.examples import examples
from harness.link_pair import STEP, Pair
from harness.places import ROBOTS
from valor.common.arrays import FloatArray
from valor.common.instance import LEAST_LINK_RATE, LINK_RATE
from valor.link.classes import BY_CLASS, MessageClass, rates
from valor.link.endpoint import Arrived, Channel, MessagesExpired
from valor.link.errors import SealError
from valor.link.fields import Layout
from valor.link.state import RobotState
from valor.robot.description import RobotDescription

DESCRIPTION = RobotDescription.load(ROBOTS / "escher")
LAYOUT = Layout(DESCRIPTION)
LEGS = [*DESCRIPTION.group_indices("left_leg"), *DESCRIPTION.group_indices("right_leg")]
BAD = Conditions(bandwidth=9600.0, delay=0.1, jitter=0.2, loss=0.15, duplication=0.1, reordering=0.1, held=1.0)


class Robot:
    """A robot whose legs swing as in a walk."""

    def __init__(self) -> None:
        self.turns, self.legs = 0, np.isin(np.arange(len(DESCRIPTION.joints)), LEGS)

    def __call__(self) -> RobotState:
        self.turns += 1
        phases = 0.3 * self.turns + np.arange(len(self.legs), dtype=np.float64)
        joints: FloatArray = np.where(self.legs, 0.3 * np.sin(phases), 0.0)
        swing = np.sin(0.3 * self.turns + np.arange(6.0))
        return RobotState(
            joints=joints, stamp=100 * self.turns, mode="walk", mode_age=0.0, behavior="walk", behavior_age=0.0,
            base_position=np.array((0.025 * self.turns, 0.03 * swing[0], 1.0)), base_velocity=0.2 * swing[:3],
            base_turn=0.3 * swing[3:], foot_forces=300.0 * swing, foot_torques=20.0 * swing,
        )  # fmt: skip


def pair(conditions: Conditions = DRC_SLOW, **more: object) -> Pair:
    return Pair(LAYOUT, Robot(), conditions, **more)  # type: ignore[arg-type]


def test_the_budgets_of_both_ends_fit_into_the_channel() -> None:
    assert rates(LINK_RATE, True).budget + rates(LINK_RATE, False).budget <= LINK_RATE


@pytest.mark.parametrize("seed", range(3))
def test_whatever_is_told_beside_it_eight_states_come_in_every_second(seed: int) -> None:
    chance, link = random.Random(seed), pair()
    link.until(lambda: link.operator.states > 3, 10.0)
    began, passed = link.now, sum(line.passed for line in link.lines.values())
    came, told, number = [], 0, link.operator.states
    while link.now < began + 60.0:
        if chance.random() < STEP / 1.2:  # a step begins
            told = link.robot.replace(MessageClass.PROGRESS, chance.randbytes(20), link.robot_time, told)
        if chance.random() < STEP / 6.0:
            link.robot.send(MessageClass.EVENT, chance.randbytes(80), link.robot_time)
        if chance.random() < STEP / 10.0:  # a plan, its steps told, a mode
            link.operator.send(MessageClass.COMMAND, chance.randbytes(110), link.now)
            link.robot.send(MessageClass.PROGRESS, chance.randbytes(110), link.robot_time)
        if chance.random() < STEP / 10.0:
            link.operator.send(MessageClass.COMMAND, b"mode", link.now)
        link.step()
        came += [link.now] * (link.operator.states - number)
        number = link.operator.states
    assert sum(line.passed for line in link.lines.values()) - passed <= LINK_RATE * 60.0
    a_second = np.histogram(came, np.arange(began, began + 60.5))[0]
    assert a_second.min() >= 8, a_second
    assert max(np.array(came[8:]) - came[:-8]) <= 1.0 + 4 * STEP, "nor in a second that begins at any other time"
    assert len(link.executed) > 5 and len(link.answers) > 20


@pytest.mark.parametrize("rate", [LEAST_LINK_RATE, 800.0])
def test_at_a_lower_rate_goals_are_executed_and_a_stop_comes_within_a_second(rate: float) -> None:
    link = pair(Conditions(bandwidth=8 * rate, delay=0.05), rate=rate)
    link.until(lambda: link.operator.states > 3, 10.0)
    goals = [bytes((number,)) * 250 for number in range(8)]
    for goal in goals:
        link.operator.send(MessageClass.COMMAND, goal, link.now)
        link.run(5.0)
    sent = link.now
    link.operator.send(MessageClass.STOP, b"a stop", link.now)
    link.until(lambda: link.executed[-1][2] == b"a stop", 5.0)
    assert link.now - sent < 1.0 and [content for _, _, content in link.executed] == [*goals, b"a stop"]


def test_a_stop_overtakes_what_waits_and_nothing_sent_before_it_is_obeyed_after_it() -> None:
    link = pair()
    link.until(lambda: link.operator.states, 10.0)
    for number in range(8):
        link.operator.send(MessageClass.COMMAND, bytes([number]) * 290, link.now)
    link.run(0.1)
    link.operator.send(MessageClass.STOP, b"stop", link.now)
    sent = link.now
    link.until(lambda: any(kind is MessageClass.STOP for _, kind, _ in link.executed), 3.0)
    stopped = next(at for at, kind, _ in link.executed if kind is MessageClass.STOP)
    assert stopped - sent < 1.0
    link.run(10.0)
    assert not [each for each in link.executed if each[0] > stopped]


def test_what_a_stop_overtakes_on_its_way_is_refused_and_what_waits_is_let_go() -> None:
    link = pair()
    link.until(lambda: link.operator.states, 10.0)
    first = link.operator.send(MessageClass.COMMAND, b"overtaken", link.now)
    held = link.operator.turn(link.now)
    second = link.operator.send(MessageClass.COMMAND, b"waits", link.now)
    link.operator.send(MessageClass.STOP, b"stop", link.now)
    given_up = [event for event in link.operator.events() if isinstance(event, MessagesExpired)]
    assert [event.ids for event in given_up] == [{first, second}]
    for _, data in (*link.operator.turn(link.now), *held):
        link.robot.receive(data, Channel.SLOW, link.robot_time)
    arrived = {event.content: event.rejection for event in link.robot.events() if isinstance(event, Arrived)}
    assert set(arrived) == {b"overtaken", b"stop"}
    assert not arrived[b"stop"] and "stop was sent after" in arrived[b"overtaken"]


def test_what_was_sent_before_a_cut_is_not_obeyed_after_it() -> None:
    link = pair(cuts=[(5.0, 20.0)])
    link.until(lambda: link.now > 5.1, 10.0)
    link.operator.send(MessageClass.COMMAND, b"walk on", link.now)
    link.operator.stream(MessageClass.STREAM, b"velocity", link.now)
    link.run(30.0)
    assert link.operator.states and not link.executed and link.given_up


def test_what_waits_is_bounded_and_the_newest_refusals_are_told() -> None:
    link = pair()
    link.until(lambda: link.operator.states, 10.0)
    most = BY_CLASS[MessageClass.EVENT].capacity
    for number in range(3 * most):
        link.robot.send(MessageClass.EVENT, bytes([number % 256]), link.robot_time)
    for _ in range(BY_CLASS[MessageClass.COMMAND].capacity):
        link.operator.send(MessageClass.COMMAND, b"", link.now)
    with pytest.raises(SealError, match="not acknowledged"):
        link.operator.send(MessageClass.COMMAND, b"one more", link.now)
    link.run(30.0)
    assert [each for each in link.answers if each] == [bytes([number % 256]) for number in range(2 * most, 3 * most)]


def test_without_the_other_end_nothing_can_be_sent() -> None:
    link = pair(cuts=[(0.0, 100.0)])
    link.run(1.0)
    with pytest.raises(SealError, match="no datagram of the other end"):
        link.operator.send(MessageClass.COMMAND, b"", link.now)


def test_an_end_that_starts_anew_is_found_again_and_knows_nothing_of_what_was() -> None:
    link = pair()
    link.until(lambda: link.operator.states > 10, 10.0)
    link.operator.send(MessageClass.COMMAND, b"before", link.now)
    link.begin_robot()
    link.run(15.0)
    assert link.operator.state is not None and not link.executed
    link.begin_operator()
    link.until(lambda: link.operator.states > 10, 20.0)
    link.operator.send(MessageClass.COMMAND, b"after", link.now)
    link.until(lambda: b"after" in link.answers, 10.0)


def test_in_a_window_of_the_fast_channel_more_states_come() -> None:
    link = pair(fast=DRC_FAST, windows=[(10.0, 12.0)])
    link.until(lambda: link.now > 8.0, 10.0)
    before = link.operator.states
    link.until(lambda: link.now > 10.0, 10.0)
    slow, middle = link.operator.states - before, link.operator.states
    link.until(lambda: link.now > 12.0, 10.0)
    assert link.operator.states - middle > 2 * slow


def test_of_another_robot_the_end_is_refused_and_named() -> None:
    link = pair()
    link.operator.session._print = b"other-rb"
    link.run(3.0)
    assert not link.operator.states and "other files of the robot" in link.operator.session.mismatch


@examples(60)
@given(st.binary(max_size=120), st.sampled_from((b"\x00", b"\x01", b"\x02", b"")))
def test_strangers_datagrams_are_counted_and_nothing_else(data: bytes, begins: bytes) -> None:
    link = PLAIN
    before = link.robot.rejected
    link.robot.receive(begins + data, 0, link.robot_time)  # type: ignore[arg-type]
    assert link.robot.rejected == before + 1 and not link.robot.events()


PLAIN = pair()
PLAIN.until(lambda: PLAIN.operator.states > 3, 10.0)


@examples(5)
@given(st.integers(0, 2**31), st.booleans())
def test_however_bad_the_link_commands_are_obeyed_once_in_time_or_not_at_all(seed: int, fast: bool) -> None:
    chance = random.Random(seed)
    cuts, at = [], 3.0
    for _ in range(6):
        start = at + chance.uniform(0.2, 4.0)
        at = start + chance.choice((0.2, 2.0, 8.0))
        cuts.append((start, at))
    link = pair(
        BAD, seed=seed, cuts=cuts, **({"fast": DRC_FAST, "windows": random_windows(seed, 60.0)} if fast else {})
    )
    sent: dict[bytes, tuple[float, MessageClass]] = {}
    stops: list[float] = []
    while link.now < at + 12.0:
        link.step()
        if link.operator.state is not None:  # the age that is told is never less than the true one
            true = link.robot_time - (link.operator.state.clock / 1e3 + link.robot._started)
            assert link.operator.age(link.now) >= true - 2e-3
        if link.now < at and chance.random() < 0.02 and link.operator.session.established:
            kind = (
                MessageClass.STOP
                if chance.random() < 0.1
                else chance.choice((MessageClass.COMMAND, MessageClass.STREAM))
            )
            content = f"{len(sent)} {kind.name} ".encode() + bytes(chance.choice((0, 300, 700)))
            try:
                (link.operator.stream if kind is MessageClass.STREAM else link.operator.send)(kind, content, link.now)
            except SealError:
                continue
            sent[content] = (link.now, kind)
            stops += [link.now] * (kind is MessageClass.STOP)
    counts = Counter(content for _, _, content in link.executed)
    assert set(counts) <= set(sent) and max(counts.values(), default=0) <= 1
    stopped = {content: when for when, kind, content in link.executed if kind is MessageClass.STOP}
    for when, kind, content in link.executed:
        lasts = BY_CLASS[kind].deadline
        assert lasts is not None and when - sent[content][0] <= lasts + 0.05
        if kind is MessageClass.COMMAND:
            after = [at for stop, at in stopped.items() if sent[stop][0] > sent[content][0]]
            assert all(when <= at for at in after), "obeyed after a stop that was sent later"
