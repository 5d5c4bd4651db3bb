"""Between `valorctl` and an agent, over real sockets: what is done, what comes too late, who is gone."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import bifrost
from bifrost import Computer
from bifrost.network import own_key_file
from valor.common.errors import ValorError
from valor.valorctl.hosts.channel import HELLO, Desk, GoneError, HostError, Switchboard
from valor.valorctl.ros_domain import daemon_ports


class Agent:
    """A desk in a thread, with a verb that counts and one that refuses."""

    def __init__(self, network: bifrost.Network) -> None:
        self.done: list[int] = []
        self.desk = Desk(network, {HELLO: lambda: None, "count": self.count, "refuse": self.refuse})
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def count(self, number: int, seconds: float = 0.0) -> int:
        time.sleep(seconds)
        self.done.append(number)
        return number + 1

    def refuse(self) -> None:
        raise ValorError("not today")

    def _run(self) -> None:
        while not self._stop.is_set():
            self.desk.run_once()
        self.desk.close()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()


@pytest.fixture
def network(tmp_path: Path, ros_domain: int) -> bifrost.Network:
    """Of one agent at an address, and one where nobody listens."""
    port = daemon_ports(ros_domain)[5]
    computers = [Computer("here", "127.0.0.1", port), Computer("nobody", "127.0.0.3", port)]
    charter = bifrost.Charter(tmp_path / "owners", {}, {f"host/{name}": [name] for name in ("here", "nobody")})
    bifrost.Network.create_for(computers, tmp_path / "network.json", tmp_path / "keys", charter)
    own = own_key_file(tmp_path / "owners", "here")
    return bifrost.Network.load(tmp_path / "network.json", tmp_path / "keys", "here", own)


@pytest.fixture
def agent(network: bifrost.Network) -> Iterator[Agent]:
    made = Agent(network)
    yield made
    made.close()


def test_what_is_asked_is_done_and_refusals_name_the_host(network: bifrost.Network, agent: Agent) -> None:
    with Switchboard(network) as switchboard:
        assert switchboard.ask("count", {"here": {"number": 4}}) == {"here": 5}
        refused = switchboard.ask("refuse", {"here": {}})["here"]
        unknown = switchboard.ask("dance", {"here": {}})["here"]
        wrong = switchboard.ask("count", {"here": {"nummer": 4}})["here"]
    assert isinstance(refused, HostError) and str(refused) == "here: not today"
    assert "dance: no verb of this agent's" in str(unknown)
    assert isinstance(wrong, HostError) and not isinstance(wrong, GoneError)
    assert agent.done == [4]


def test_what_comes_after_it_ceased_to_hold_is_not_done(network: bifrost.Network, agent: Agent) -> None:
    with Switchboard(network) as switchboard:
        assert switchboard.ask("count", {"here": {"number": 1}}) == {"here": 2}
        late = switchboard.ask("count", {"here": {"number": 2}}, timeout=-1.0)["here"]
        assert isinstance(late, HostError) and "after it had ceased to hold; nothing was done" in str(late)
    assert agent.done == [1]


def test_a_host_that_works_for_long_is_waited_for_and_one_that_is_gone_is_not(
    network: bifrost.Network, agent: Agent
) -> None:
    with Switchboard(network) as switchboard:
        asked: dict[str, dict[str, Any]] = {"here": {"number": 7, "seconds": 4.0}, "nobody": {"number": 8}}
        answers = switchboard.ask("count", asked, timeout=60.0)
        assert answers["here"] == 8, "longer than a host that says nothing is waited for"
        assert isinstance(answers["nobody"], GoneError)
        began = time.monotonic()
        assert isinstance(switchboard.ask("count", {"nobody": {"number": 8}})["nobody"], GoneError)
        assert time.monotonic() - began < 2.0, "it was waited for twice"
    assert agent.done == [7]
