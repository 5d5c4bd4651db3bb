"""The name service: nodes find each other, and continue without it."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

import bifrost
from bifrost.table_cache import recall
from harness.bifrost_network import Answer, BifrostNetwork, Question, Sample, until


def names(node: bifrost.Node) -> set[str]:
    return set(node.graph(timeout=10.0).nodes)


def left_on_disk(net: BifrostNetwork) -> set[str]:
    return {record.name for record in recall(net.network)}


def test_recall_finds_the_nodes_of_the_last_daemon(own_net: BifrostNetwork) -> None:
    own_net.peer("serve", "lab/ask")
    speaker = own_net.peer("publish", "lab/sample", "100")
    node = own_net.node("test")
    until(lambda: left_on_disk(own_net) == {"serve_peer", "publish_peer", "test"}, "all are on disk")
    assert own_net.network.table_cache is not None and own_net.network.table_cache.stat().st_mode & 0o777 == 0o600
    node.close()
    until(lambda: "test" not in left_on_disk(own_net), "who has left is not")
    own_net.kill_daemon()

    late = own_net.node_in(own_net.network, "late", recall=True)
    subscriber = late.subscriber("lab/sample", Sample)
    assert late.client("lab/ask", Question, Answer).call(Question("open", 0.0), timeout=60.0).handled == 1
    assert subscriber.receive(timeout=60.0) is not None
    speaker.kill()
    subscriber.latest()  # its last
    assert left_on_disk(own_net) == {"serve_peer"}, "a process that has ended is nobody"

    own_net.peer("publish", "lab/sample", "100")
    own_net.start_daemon()
    assert late.discovery.wait_change(lambda: late.discovery.registered, 20.0)
    until(subscriber.latest, "who came meanwhile is found, too")
    daemon = own_net.daemons.popitem()[1]
    daemon.terminate()
    daemon.wait(20.0)
    assert not own_net.network.table_cache.exists(), "one that ends in order leaves nothing"


@pytest.mark.parametrize("content", [b"", b"\xc1", b"\x91" * 100_000, b'{"type": "table"}'], ids=repr)
def test_an_invalid_table_on_disk_is_ignored(tmp_path: Path, content: bytes) -> None:
    network = bifrost.Network.create(tmp_path / "network.json", tmp_path / "keys")
    assert recall(network) == [] and network.table_cache is not None
    network.table_cache.write_bytes(content)
    assert recall(network) == []


def test_a_restarted_daemon_with_an_empty_table_ends_no_connection(own_net: BifrostNetwork) -> None:
    peer = own_net.peer("publish", "lab/sample", "100")
    subscriber = own_net.node("test").subscriber("lab/sample", Sample, queue=10_000)
    assert subscriber.receive(timeout=60.0)
    own_net.kill_daemon()
    peer.signal(signal.SIGSTOP)  # it cannot register again
    own_net.start_daemon()
    watching = own_net.node("watching")
    until(lambda: {"test", "watching"} <= names(watching), "the others have registered again")
    subscriber.drain()
    peer.signal(signal.SIGCONT)
    assert subscriber.receive(timeout=60.0) is not None and subscriber.drops == 0


def test_the_daemon_reports_its_status(own_net: BifrostNetwork) -> None:
    info = bifrost.daemon_alive(own_net.network, timeout=5.0)
    assert info is not None and info.pid == own_net.daemon.pid and info.uptime > 0.0 and 1.0 < info.memory_mib < 200.0
    own_net.kill_daemon()
    assert bifrost.daemon_alive(own_net.network, timeout=0.2) is None
    with pytest.raises(bifrost.TimeoutError, match="does not respond"):
        own_net.node("test").graph(timeout=0.1)


def run_daemon(environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bifrost.daemon"], env=environment, capture_output=True, text=True, timeout=30,
        check=False,
    )  # fmt: skip


def test_a_daemon_that_cannot_start_gives_the_reason_in_one_line(net: BifrostNetwork, tmp_path: Path) -> None:
    taken = run_daemon(net.environment())
    assert taken.returncode == 75  # another start may succeed
    assert taken.stderr.count("\n") == 1
    assert f"cannot listen on {net.network.computer.daemon}: Address already in use" in taken.stderr
    missing = run_daemon(net.environment() | {"BIFROST_NETWORK": str(tmp_path / "none.json")})
    assert missing.returncode == 78 and "none.json: no such network file" in missing.stderr
    assert missing.stderr.count("\n") == 1
