"""Rights of owners: other processes, with common keys or another owner's, cannot use them."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
import zmq

import bifrost
from bifrost import Grants, directory
from bifrost.network import own_key_file, read_grants
from bifrost.security import connect
from harness import bifrost_network
from harness.bifrost_network import Answer, BifrostNetwork, Question, Sample, connected, going_on, sample, until
from valor.valorctl.instance.ros_domain import daemon_ports

OWNED, FREE, SERVICE = "arm/motor", "lab/free", "arm/ask"
SILENCE = 0.3  # in which a message would have come [s]


@pytest.fixture(scope="module")
def lasting(tmp_path_factory: pytest.TempPathFactory, ros_domain: int) -> Iterator[BifrostNetwork]:
    """Two computers, near and far; the arm owns a topic and a service, the recorder another topic."""
    folder, ports = tmp_path_factory.mktemp("granted"), daemon_ports(ros_domain)
    computers = bifrost_network.two_computers(folder, ports)
    publishers = {OWNED: ["arm", "spare"], "recorder/state": ["recorder"]}
    made = BifrostNetwork(folder, ports, computers, publishers, {SERVICE: ["arm"]})
    made.start_daemon("near")
    made.start_daemon("far")
    yield made
    made.close()


@pytest.fixture
def net(lasting: BifrostNetwork) -> Iterator[BifrostNetwork]:
    yield lasting
    lasting.dismiss()


def ignorant(net: BifrostNetwork, owner: str = "") -> bifrost.Network:
    """The network as somebody sees it who does not care what is granted to whom."""
    network = net.on("near", owner)
    daemon = {"bifrostd": network.grants.owners["bifrostd"]}
    return replace(network, grants=Grants(daemon))


def refusal(net: BifrostNetwork, computer: str = "near") -> str:
    info = bifrost.daemon_alive(net.on(computer), 5.0)
    assert info is not None
    return info.refusal


def test_members_receive_from_owners_and_owners_from_members(net: BifrostNetwork) -> None:
    arm, member = net.node("arm", "near", "arm"), net.node("member", "far")
    connected(
        arm.publisher(OWNED, Sample),
        member.subscriber(OWNED, Sample, queue=100),
        arm.subscriber(OWNED, Sample, queue=100),
    )
    connected(member.publisher(FREE, Sample), arm.subscriber(FREE, Sample, queue=100))
    latched = arm.publisher(FREE + "/of_the_arm", Sample, latched=True)
    latched.publish(sample(7))
    assert member.subscriber(FREE + "/of_the_arm", Sample).receive(10.0) is not None
    connected(net.node("spare", "far", "spare").publisher(OWNED, Sample), member.subscriber(OWNED, Sample, queue=100))


def test_publishing_without_the_right_raises_at_once(net: BifrostNetwork) -> None:
    for owner, name in (("", "evil"), ("recorder", "recorder")):
        node = net.node(name, "near", owner)
        with pytest.raises(bifrost.Error, match=f"^{name} may not publish arm/motor, which belongs to arm or spare$"):
            node.publisher(OWNED, Sample)
        with pytest.raises(bifrost.Error, match=f"^{name} may not serve arm/ask, which belongs to arm$"):
            node.server(SERVICE, Question, Answer, lambda question, origin: Answer("", 0))


@pytest.mark.parametrize("stolen", ["", "recorder"])
@pytest.mark.parametrize("first", [True, False])
def test_a_false_publisher_is_rejected_by_name_and_not_received(net: BifrostNetwork, stolen: str, first: bool) -> None:
    arm = None if first else net.node("arm", "near", "arm")
    real = arm and arm.publisher(OWNED, Sample)
    hears = [net.node(name, name).subscriber(OWNED, Sample, queue=1000) for name in ("near", "far")]
    evil = net.node_in(ignorant(net, stolen), "evil")
    forged = evil.publisher(OWNED, Sample)
    until(
        lambda: refusal(net).startswith("evil may not publish arm/motor, which belongs to arm or spare: rejected"),
        "refused",
    )
    assert f"key of {stolen or 'member'}" in refusal(net)
    real = real or net.node("arm", "near", "arm").publisher(OWNED, Sample)
    connected(real, *hears)
    for count in range(50):
        forged.publish(sample(1000 + count))
        real.publish(sample(count))
    for subscriber in hears:
        assert subscriber.publishers == ("arm",)
        came = []
        while (received := subscriber.receive(SILENCE)) is not None:
            came.append((received.origin, received.message.count))
        assert came[-50:] == [("arm", count) for count in range(50)] and {origin for origin, _ in came} == {"arm"}
    assert {end.node for end in net.node("watching", "far").graph(5.0).topics[OWNED].publishers} == {"arm"}


def test_a_false_key_of_another_endpoint_is_rejected(net: BifrostNetwork) -> None:
    """Who announces the owner's public key cannot listen with it: not even a false daemon makes a false publisher."""
    evil = net.node_in(ignorant(net), "evil")
    forged = evil.publisher(OWNED, Sample)
    until(lambda: refusal(net).startswith("evil may not"), "its own registration is refused")
    record = next(r for r in evil.discovery.records() if r.name == "evil")
    [entry] = record.entries
    keys = net.network.grants.owners
    lie = directory.NodeRecord("arm", 77, 1, "near", 1, (announced(entry, keys["arm"]),), record.schemas)
    victim = net.node("victim", "near")
    kinds = {evil: [zmq.DEALER], victim: [zmq.SUB, zmq.SUB]}
    with contextlib.ExitStack() as opened:
        opening = [node.discovery.connecting_socket(kind) for node in kinds for kind in kinds[node]]
        sockets = [opened.enter_context(socket) for socket in opening]
        liar, believing, knowing = sockets
        connect(liar, net.network.computer.daemon, keys["bifrostd"].encode())
        liar.send(directory.encode(directory.Register(lie)))
        # Not its latest refusal: "evil" registers a second time when the daemon answers its first heartbeat.
        until(lambda: "arm may not publish arm/motor" in net.log.read_text(), "the daemon rejects the registration")

        def received_by(direct: zmq.Socket[bytes]) -> bool:
            forged.publish(sample(1))
            return bool(direct.poll(20))

        for direct, key in ((believing, keys["arm"]), (knowing, "")):
            direct.setsockopt(zmq.SUBSCRIBE, b"")
            victim.discovery.connect(direct, announced(entry, key))
        until(lambda: received_by(knowing), "who asks for the key that is there hears it")
        assert not any(received_by(believing) for _ in range(20))


def announced(entry: directory.Entry, key: str) -> directory.Entry:
    """The same, announced with a key."""
    return msgspec.structs.replace(entry, key=key)


def test_only_an_owner_changes_its_node(net: BifrostNetwork) -> None:
    arm, member = net.node("arm", "near", "arm"), net.node("member", "near")
    connected(arm.publisher(OWNED, Sample), member.subscriber(OWNED, Sample, queue=100))
    socket = member.discovery.connecting_socket(zmq.DEALER)
    connect(socket, net.network.computer.daemon, net.network.daemon_key)
    mine = arm.discovery.incarnation
    for lie in (
        directory.Leave(mine),
        directory.Register(directory.NodeRecord("arm", mine, 1, "near", 1)),
        directory.Heartbeat(mine, 0, -1),
    ):
        before = bifrost.daemon_alive(net.on("near"), 5.0)
        socket.send(directory.encode(lie))
        until(
            lambda before=before: bifrost.daemon_alive(net.on("near"), 5.0).refused > before.refused,  # type: ignore[union-attr,misc]
            "refused",
        )
    assert refusal(net) == "member may not change arm, which belongs to arm: rejected"
    assert [end.node for end in member.graph().topics[OWNED].publishers] == ["arm"]
    socket.send(directory.encode(directory.Follow("far", 0, -1)))
    until(lambda: "may not follow as the daemon of far" in refusal(net), "no member is a daemon")
    socket.close()


def test_a_false_server_gets_no_request(net: BifrostNetwork) -> None:
    evil = net.node_in(ignorant(net, "recorder"), "evil")
    asked: list[str] = []
    false = evil.server(SERVICE, Question, Answer, lambda question, origin: asked.append(origin) or Answer("evil", 0))  # type: ignore[func-returns-value]
    client = net.node("client", "far").client(SERVICE, Question, Answer)
    until(lambda: "evil may not serve arm/ask, which belongs to arm" in refusal(net), "refused")
    with pytest.raises(bifrost.NoServerError):
        client.call(Question("open", 0.0), timeout=SILENCE)
    true = net.node("arm", "near", "arm").server(SERVICE, Question, Answer, lambda question, origin: Answer("arm", 1))
    with going_on(lambda: bifrost.wait([true], timeout=0.05) and true.serve()):
        assert client.call(Question("open", 0.0), timeout=60.0).text == "arm"
    assert (false.serve(), asked) == (0, [])


def test_a_daemon_without_its_key_reports_it(net: BifrostNetwork, tmp_path: Path) -> None:
    started = subprocess.run(
        [sys.executable, "-m", "bifrost.daemon"], env=net.environment("near") | {"BIFROST_OWNERS": ""},
        capture_output=True, text=True, timeout=30, check=False,
    )  # fmt: skip
    assert (started.returncode, started.stderr.count("\n")) == (78, 1)
    assert "the key of bifrostd is missing: expected its folder in BIFROST_OWNERS" in started.stderr


def test_key_files_are_private_to_their_process(net: BifrostNetwork) -> None:
    for owner in ("bifrostd", "arm", "spare", "recorder"):
        file = own_key_file(net.owners, owner)
        assert [path.stat().st_mode & 0o777 for path in (file, file.parent)] == [0o600, 0o700]
    stranger = own_key_file(net.owners, "stranger")
    stranger.parent.mkdir(mode=0o700)
    pair = bifrost.network.KeyPair.new()
    descriptor = os.open(stranger, os.O_WRONLY | os.O_CREAT, 0o600)
    os.write(descriptor, pair.public + b"\n" + pair.secret + b"\n")
    os.close(descriptor)
    with pytest.raises(bifrost.ConfigurationError, match="no key of an owner"):
        net.on("near", "stranger")
    with pytest.raises(bifrost.ConfigurationError, match="no such Bifrost key"):
        net.on("near", "nobody")


@pytest.mark.parametrize(
    ("content", "what"),
    [
        ({"owners": {"arm": "short"}}, "owners.arm: expected a public key"),
        ({"owners": 3}, "owners, publishers, servers: "),
        ({"publishers": {"a": ["arm"]}}, "publishers.a: expected names of owners"),
        ({"owners": {"arm": "x" * 40}, "servers": {"a": []}}, "servers.a: expected names of owners"),
    ],
)
def test_invalid_grants_are_rejected(content: dict[str, object], what: str) -> None:
    with pytest.raises(bifrost.ConfigurationError, match=what):
        read_grants(content, Path("network.json"))
