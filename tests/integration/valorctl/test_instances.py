"""Instances side by side: networks, keys and ROS domains of their own."""

from __future__ import annotations

import itertools
import os
import signal

import bifrost
from harness.waiting import wait_until
from tests.integration.valorctl.command_line import BIFROST_ALONE, PATIENCE, TIMEOUT, Cli
from tests.unit.test_ros_domain import homes_that_begin_alike
from valor.common.instance import Instance
from valor.valorctl.ros_domain import is_reserved


def test_two_instances_do_not_meet(ctl: Cli) -> None:
    profile = ctl.profile(BIFROST_ALONE)
    ctl("up", "--profile", profile, "--instance", "one")
    ctl("--instance", "two", "up", "--profile", profile)
    environments = {}
    for name in ("one", "two"):
        lines = ctl("env", "--instance", name).splitlines()
        environments[name] = dict(line.removeprefix("export ").split("=", 1) for line in lines)
    for variable in ("VALOR_INSTANCE", "ROS_DOMAIN_ID", "BIFROST_NETWORK", "BIFROST_KEYS"):
        assert environments["one"][variable] != environments["two"][variable]

    networks = [
        bifrost.Network.load(ctl.home / name / "network.json", ctl.home / name / "keys") for name in ("one", "two")
    ]
    assert networks[0].server.public != networks[1].server.public
    with bifrost.Node("first", network=networks[0]) as first, bifrost.Node("second", network=networks[1]) as second:
        assert wait_until(lambda: "first" in first.graph().nodes, 10.0, "the first node is registered")
        assert wait_until(lambda: "second" in second.graph().nodes, 10.0, "the second node is registered")
        assert first.graph().nodes == ["first"]
        assert second.graph().nodes == ["second"]

    ctl("down", "--instance", "one")
    assert ctl.status("two")["services"]["bifrostd"]["state"] == "ready"
    ctl("down", "--instance", "two")
    ctl.assert_nothing_left("one")
    ctl.assert_nothing_left("two")


def test_two_homes_that_come_up_at_once_get_domains_of_their_own(ctl: Cli) -> None:
    homes = list(itertools.islice(homes_that_begin_alike(ctl.home), 2))
    both = [Cli(home) for home in homes]
    try:
        for cli in both:
            cli.home.mkdir()
        starting = [cli.start("--instance", "x", "up", "--profile", cli.profile(BIFROST_ALONE)) for cli in both]
        assert [process.wait(TIMEOUT) for process in starting] == [0, 0]
        domains = [Instance("x", home).settings().ros_domain_id for home in homes]
        assert domains[0] != domains[1]
        assert all(is_reserved(domain) for domain in domains)  # though no ROS node is there
        os.kill(both[0].supervisord("x"), signal.SIGKILL)
        wait_until(lambda: not is_reserved(domains[0]), PATIENCE, "a domain goes with its supervisor")
        for cli in both:
            cli("down", "--instance", "x")
            cli.assert_nothing_left("x")
    finally:
        for process in (process for cli in both for process in cli.processes()):
            process.kill()
