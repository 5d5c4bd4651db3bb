"""Who sends too much is named, counted and muted while it goes on; everybody else is heard."""

from __future__ import annotations

import time

from hypothesis import given
from hypothesis import strategies as st

import bifrost
from bifrost.limits import Limit, Meter
from harness.bifrost_network import (
    Answer,
    BifrostNetwork,
    Question,
    Sample,
    connected,
    going_on,
    sample,
    sequences,
    until,
)
from harness.examples import examples
from harness.waiting import PATIENCE

LIMIT = Limit(rate=500.0, burst=100)


def test_what_a_bounded_drain_leaves_is_told_again(net: BifrostNetwork) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    subscriber = net.node("subscriber").subscriber("lab/sample", Sample, queue=1000)
    poller = bifrost.Poller([subscriber])
    first = connected(publisher, subscriber)
    last = [publisher.publish(sample(0)) for _ in range(100)][-1]
    came: list[int] = []

    def all_came() -> bool:
        for each in poller.look(0.1):
            taken = each.drain(most=7)
            assert len(taken) <= 7
            came.extend(received.sequence for received in taken)
        return bool(came) and came[-1] == last

    until(all_came, "all came")
    assert came == list(range(first + 1, last + 1))
    assert subscriber.drain(within=0.0) == [] and not subscriber.left
    publisher.publish(sample(0))
    publisher.publish(sample(0))
    until(subscriber.ready, "another came")
    assert len(subscriber.drain(within=0.0)) == 1  # whatever the time, one
    poller.close()


def test_a_flooding_publisher_is_named_and_muted_and_heard_again(net: BifrostNetwork) -> None:
    """By where it sends from: it calls itself what the honest one is called."""
    honest = net.node("honest").publisher("lab/sample", Sample)
    subscriber = net.node("subscriber").subscriber("lab/sample", Sample, queue=16, limit=LIMIT)
    connected(honest, subscriber)
    flooder = net.node("honest").publisher("lab/sample", Sample)
    message = sample(-1)

    def heard_from(count: int) -> bool:
        return any(received.message.count == count for received in subscriber.drain(most=8))

    with going_on(lambda: flooder.publish(message)):
        until(lambda: (subscriber.drain(most=8), subscriber.muted)[1], "it is muted")
        assert subscriber.muted == ("honest",)
        while subscriber.drain():
            pass
        first = last = honest.publish(sample(0))
        came: list[int] = []
        for _ in range(100):
            last = honest.publish(sample(1))
            came += [received.sequence for received in subscriber.drain() if received.message.count >= 0]
            time.sleep(0.002)

        def all_came() -> bool:
            came.extend(received.sequence for received in subscriber.drain() if received.message.count >= 0)
            return came[-1:] == [last]

        until(all_came, "all of the other came")
        assert came == list(range(first, last + 1))
        until(lambda: (subscriber.drain(most=8), subscriber.floods >= 2)[1], "it goes on, and is muted again")
    until(lambda: not subscriber.muted and flooder.publish(sample(7)) and heard_from(7), "it is heard again")
    assert subscriber.drops > 0


def test_an_honest_sender_is_not_muted_however_late_it_is_heard(net: BifrostNetwork) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    subscriber = net.node("subscriber").subscriber("lab/sample", Sample, queue=10, limit=LIMIT)
    connected(publisher, subscriber)
    for _ in range(3 * LIMIT.burst):  # at half the rate or less, unheard
        sequence = publisher.publish(sample(0))
        time.sleep(0.004)
    sequences(subscriber, sequence)
    for _ in range(LIMIT.burst // 2):  # and at once
        sequence = publisher.publish(sample(0))
    while (received := subscriber.receive(timeout=0.2)) is not None:
        assert received.sequence <= sequence
    assert (subscriber.muted, subscriber.floods) == ((), 0)


def test_a_flooding_client_is_named_and_muted_and_others_are_answered(net: BifrostNetwork) -> None:
    node = net.node("server")
    server = node.server("lab/ask", Question, Answer, lambda q, origin: Answer(origin, 0), Limit(rate=10.0, burst=20))
    flooder = net.node("flooder").client("lab/ask", Question, Answer)
    other = net.node("other").client("lab/ask", Question, Answer)
    question = Question("open", 0.0)
    counts: list[int] = []

    with going_on(lambda: counts.append(server.serve(most=5))):
        assert other.call(question, PATIENCE).text == "other"
        assert flooder.call(question, PATIENCE).text == "flooder"
        socket = flooder._socket
        assert socket is not None
        frame = flooder._frame(flooder._request.encode(question), time.monotonic() + PATIENCE, flooder._watch.peers[-1])
        for _ in range(100):
            socket.send(frame)
        until(lambda: server.muted, "it is muted")
        assert server.muted == ("flooder",)
        assert [other.call(question, PATIENCE).text for _ in range(5)] == ["other"] * 5
        until(lambda: not server.muted, "it has stopped")
        assert flooder.call(question, PATIENCE).text == "flooder"
    assert server.rejected >= 70
    assert max(counts) <= 5


@given(
    rate=st.floats(1.0, 1e5),
    burst=st.integers(1, 1000),
    pace=st.floats(0.01, 1.0),
    stalls=st.lists(st.integers(1, 500), min_size=1, max_size=20),
)
@examples(50)
def test_within_the_limit_nobody_exceeds_it_and_beyond_it_everybody_does(
    rate: float, burst: int, pace: float, stalls: list[int]
) -> None:
    period = int(1e9 / (rate * pace)) + 1
    meter, at = Meter(Limit(rate, burst)), 0
    assert not meter.exceeds(1, at)
    for count in stalls:  # all that was sent meanwhile is counted with the next that is heard
        at += count * period
        assert not meter.exceeds(count, at)
    period = int(0.5e9 / rate)
    times = range(at, at + (2 * burst + 4) * period, period)
    assert any(meter.exceeds(1, then) for then in times[1:])
