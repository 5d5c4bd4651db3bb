"""The ROS domain of an instance: nobody else's on this computer, whoever chooses at the same moment."""

from __future__ import annotations

import itertools
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.waiting import wait_until
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.valorctl import ros_domain
from valor.valorctl.ros_domain import DOMAINS, choose, daemon_ports, discovery_port, is_free, is_reserved

_CHOOSER = """
import sys
from pathlib import Path
from valor.common.instance import Instance
from valor.valorctl import ros_domain

print("ready", flush=True)
sys.stdin.readline()
with ros_domain.reserve_for(Instance("x", Path(sys.argv[1]))) as reservation:
    print(reservation.domain, flush=True)
    sys.stdin.read()
"""


@given(st.text(), st.sets(st.sampled_from(list(DOMAINS))), st.sets(st.sampled_from(list(DOMAINS))))
def test_a_domain_is_chosen_that_nobody_has(key: str, taken: set[int], busy: set[int]) -> None:
    if len(taken | busy) == len(DOMAINS):
        with pytest.raises(ValorError, match="no free ROS domain"):
            choose(key, taken, lambda domain: domain not in busy)
        return
    domain = choose(key, taken, lambda domain: domain not in busy)
    assert domain in DOMAINS
    assert domain not in taken | busy
    assert domain == choose(key, taken, lambda domain: domain not in busy)


def test_two_names_begin_their_search_at_different_places() -> None:
    assert len({choose(f"/home/{name}", set(), lambda _: True) for name in "abcdefgh"}) > 4


def test_domains_keep_clear_of_ephemeral_ports() -> None:
    assert discovery_port(0) == 7410
    assert discovery_port(max(DOMAINS)) + 240 < 32768 + 250


def test_a_domain_in_use_is_seen() -> None:
    with ros_domain.reserve("test") as reservation:
        domain = reservation.domain
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
            participant.bind(("127.0.0.1", discovery_port(domain)))
            assert not is_free(domain)
        assert is_free(domain)


def test_an_instance_takes_its_domain_again_beside_its_clients_and_beside_no_other_instance() -> None:
    with ros_domain.reserve("test") as reservation:
        domain = reservation.domain
        with pytest.raises(ValorError, match=f"ROS domain {domain} is another instance's"):
            ros_domain.retake(domain)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("127.0.0.1", discovery_port(domain)))
        with ros_domain.retake(domain) as again:
            assert again.domain == domain
            assert is_reserved(domain)


def test_no_port_belongs_to_two_domains_or_may_be_given_to_an_outgoing_connection() -> None:
    ports = [port for domain in (0, *DOMAINS) for port in daemon_ports(domain)]
    assert len(set(ports)) == len(ports)
    assert max(ports) < 32768


def test_domains_of_other_instances_are_taken(tmp_path: Path) -> None:
    for name, content in (("a", '{"ros_domain_id": 5}'), ("b", '{"ros_domain_id": 6}'), ("c", "garbage")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "instance.json").write_text(content)
    assert ros_domain.taken(tmp_path, but=Instance("b", tmp_path)) == {5}


def homes_that_begin_alike(folder: Path) -> Iterator[Path]:
    """Homes whose instances would take the same domain, were they alone."""
    first = choose(str(folder / "0" / "x"), set(), lambda _: True)
    for number in itertools.count():
        home = folder / str(number)
        if choose(str(home / "x"), set(), lambda _: True) == first:
            yield home


def test_homes_that_choose_at_the_same_moment_get_domains_of_their_own(tmp_path: Path) -> None:
    with ExitStack() as stack:
        choosers = [
            stack.enter_context(
                subprocess.Popen(
                    [sys.executable, "-c", _CHOOSER, str(home)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                )
            )
            for home in itertools.islice(homes_that_begin_alike(tmp_path), 4)
        ]
        for chooser in choosers:
            stack.callback(chooser.kill)
            assert chooser.stdout is not None and chooser.stdout.readline() == "ready\n"
        for chooser in choosers:
            assert chooser.stdin is not None
            chooser.stdin.write("\n")
            chooser.stdin.flush()
        domains = [int(chooser.stdout.readline()) for chooser in choosers if chooser.stdout is not None]
        assert len(set(domains)) == len(choosers), domains
        assert all(is_reserved(domain) for domain in domains)
        for chooser in choosers:
            chooser.kill()
        # Others of this computer may take one or the other.
        wait_until(lambda: not all(is_reserved(domain) for domain in domains), 10.0, "domains are given back")


def test_a_domain_is_held_by_whoever_inherited_it(tmp_path: Path) -> None:
    with ros_domain.reserve_for(Instance("x", tmp_path)) as reservation:
        heir = subprocess.Popen(["sleep", "60"], stdin=reservation.fileno())
    try:
        assert is_reserved(reservation.domain)
        with ros_domain.reserve_for(Instance("x", tmp_path)) as other:
            assert other.domain != reservation.domain
    finally:
        heir.kill()
        heir.wait()
    assert not is_reserved(reservation.domain)
