"""A sender that exceeds its limit is named, counted and muted; others are received."""

import time

from hypothesis import given
from hypothesis import strategies as st

import bifrost
from bifrost.limits import Limit, Meter
from harness.bifrost_network import Answer, BifrostNetwork, Question, Sample, connected, going_on, sample, until
from harness.examples import examples
from harness.waiting import PATIENCE, some

LIMIT = Limit(rate=500.0, burst=100)


def test_messages_left_by_a_bounded_drain_are_reported_again(net: BifrostNetwork) -> None:
    publisher = net.node("publisher").publisher("lab/sample", Sample)
    subscriber = net.node("subscriber").subscriber("lab/sample", Sample, queue=1000)
    poller = bifrost.Poller([subscriber])
    first = connected(publisher, subscriber)
    last = [publisher.publish(sample(0)) for _ in range(100)][-1]
    received: list[int] = []

    def all_received() -> bool:
        for each in poller.look(0.1):
            drained = each.drain(most=7)
            assert len(drained) <= 7
            received.extend(message.sequence for message in drained)
        return bool(received) and received[-1] == last

    until(all_received, "all messages")
    assert received == list(range(first + 1, last + 1))
    assert subscriber.drain(within=0.0) == [] and not subscriber.left
    publisher.publish(sample(0))
    publisher.publish(sample(0))
    until(subscriber.ready, "another message")
    assert len(subscriber.drain(within=0.0)) == 1  # at least one
    poller.close()


def test_a_flooding_publisher_is_named_muted_and_received_again(net: BifrostNetwork) -> None:
    honest = net.node("honest").publisher("lab/sample", Sample)
    subscriber = net.node("subscriber").subscriber("lab/sample", Sample, queue=16, limit=LIMIT)
    connected(honest, subscriber)
    flooder = net.node("flooder").publisher("lab/sample", Sample)
    counts: list[int] = []

    def drained() -> list[int]:
        counts.extend(received.message.count for received in subscriber.drain(most=8))
        return counts

    with going_on(lambda: flooder.publish(sample(-1))):
        until(lambda: (drained(), subscriber.muted)[1], "the mute")
        assert subscriber.muted == ("flooder",)
        counts.clear()
        for count in range(100):
            honest.publish(sample(count))
            drained()
            time.sleep(0.002)
        until(lambda: drained()[-1:] == [99], "all messages of the other")
        assert counts == list(range(100))
    until(lambda: flooder.publish(sample(777)) and 777 in drained(), "the end of the mute")
    assert subscriber.drops > 0


def test_a_flooding_client_is_named_and_muted_and_others_are_answered(net: BifrostNetwork) -> None:
    node = net.node("server")
    server = node.server("lab/ask", Question, Answer, lambda q, origin: Answer(origin, 0), Limit(rate=10.0, burst=20))
    flooder = net.node("flooder").client("lab/ask", Question, Answer)
    other = net.node("other").client("lab/ask", Question, Answer)
    question = Question("open", 0.0)
    counts: list[int] = []

    with going_on(lambda: counts.append(server.serve(most=5))):
        assert other.call(question, PATIENCE).text == "other" and flooder.call(question, PATIENCE).text == "flooder"
        socket = some(flooder._socket)
        frame = flooder._frame(flooder._request.encode(question), time.monotonic() + PATIENCE, flooder._watch.peers[-1])
        for _ in range(100):
            socket.send(frame)
        until(lambda: server.muted, "the mute")
        assert server.muted == ("flooder",)
        assert [other.call(question, PATIENCE).text for _ in range(5)] == ["other"] * 5
        until(lambda: not server.muted, "the end of the mute")
        assert flooder.call(question, PATIENCE).text == "flooder"
    assert server.rejected >= 70
    assert max(counts) <= 5


@given(
    rate=st.floats(1.0, 1e5), burst=st.integers(1, 1000), load=st.floats(0.01, 1.0),
    stalls=st.lists(st.integers(1, 500), min_size=1, max_size=20),
)  # fmt: skip
@examples(50)
def test_a_meter_passes_senders_within_the_limit_alone(rate: float, burst: int, load: float, stalls: list[int]) -> None:
    period = int(1e9 / (rate * load)) + 1
    meter, at = Meter(Limit(rate, burst)), 0
    assert not meter.exceeds(1, at)
    for count in stalls:  # messages sent during a stall are counted with the next one received
        at += count * period
        assert not meter.exceeds(count, at)
    period = int(0.5e9 / rate)
    times = range(at, at + (2 * burst + 4) * period, period)
    assert any(meter.exceeds(1, then) for then in times[1:])
