"""From up to down: what runs is seen, and nothing stays behind, also where up is interrupted or fails."""

import itertools
import json
import os
import shutil
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.places import ROBOTS
from harness.turns import after, known, turns
from harness.waiting import wait_until
from tests.integration.valorctl.command_line import BIFROST_ALONE, MOTION_SYSTEM, PATIENCE, TIMEOUT, Cli, shared_memory
from tests.unit.test_valorctl_help import HEAVY, imported
from valor.common.instance import Instance
from valor.common.priority import take_turns
from valor.valorctl.instance.ros_domain import choose, is_reserved


def accepts(host: str, port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((host, port)) == 0


def watched(ctl: Cli) -> None:
    """It goes on until Ctrl-C, which is no failure."""
    watch = ctl.start("status", "--watch", "--json")
    assert watch.stdout
    looks = [json.loads(watch.stdout.readline()) for _ in range(2)]
    assert looks[0]["clock"] != looks[1]["clock"]
    watch.send_signal(signal.SIGINT)
    _, err = watch.communicate(timeout=TIMEOUT)
    assert (watch.returncode, err) == (0, "")


def lean(ctl: Cli) -> None:
    """It imports nothing that takes longer than looking does."""
    environment = os.environ | {"VALOR_HOME": str(ctl.home)}
    assert imported("status", environment=environment) & HEAVY == {"rich", "zmq"}
    assert imported("status", "--json", environment=environment) & HEAVY == {"zmq"}


def test_from_up_to_down_nothing_stays_behind(ctl: Cli) -> None:
    old = ctl.home / "default" / "logs" / "old.log"
    old.parent.mkdir(parents=True)
    old.write_text("of an up under another mask\n")
    output = ctl("up", "--profile", ctl.profile(MOTION_SYSTEM), "--actuators", "ideal", "--seed", "3")
    for name in ("bifrostd", "comms_manager", "motion_manager"):
        assert f"{name} ready" in output
    seen = ctl.status()
    printed = json.loads(ctl("status", "--json"))
    assert printed.keys() | {"services"} == seen.keys()
    assert [service["name"] for service in printed["services"]] == list(seen["services"])
    assert {name: service["state"] for name, service in seen["services"].items()} == {
        "bifrostd": "ready", "comms_manager": "ready", "motion_manager": "ready",
    }  # fmt: skip
    assert seen["robot"] == "escher" and seen["behavior"] and seen["clock"]["mode"] == "lockstep"
    factor = wait_until(
        lambda: ctl.status()["clock"]["real_time_factor_since_start"], 30.0, "robot time for a real-time factor"
    )
    assert 0 < factor <= 1
    for service in seen["services"].values():
        assert service["restarts"] == 0 and service["memory_mib"] > 10 and service["cpu_percent"] >= 0
    ctl.assert_private()
    assert "comms_manager" in ctl("status")
    assert "ui.perfetto.dev" in ctl("trace", "--for", "2", "--out", str(ctl.home / "trace.json"))
    events = json.loads((ctl.home / "trace.json").read_text())["traceEvents"]
    assert {event["args"]["name"] for event in events if event["name"] == "process_name"} == {
        "comms_manager", "motion_manager",
    }  # fmt: skip
    assert sum(event["name"] == "control" for event in events) >= 3
    if known():
        comms = ctl.pid("comms_manager")
        for thread in os.listdir(f"/proc/{comms}/task"):
            assert turns(int(thread)).length == after(lambda: take_turns("short")).length
    assert "pushed" in ctl("push", "-1.5", "0", "-.5") and "finite" in ctl("push", "nan", "0", "0", status=2)
    assert "bifrostd" in ctl("logs", "-n", "300")
    watched(ctl)
    lean(ctl)
    assert ctl("logs", "bifrostd", "-n", "1").count("\n") == 1
    assert "up already" in ctl("up", "--profile", ctl.profile(MOTION_SYSTEM), status=1)

    network = json.loads((ctl.home / "default" / "network.json").read_text())["computers"][0]
    assert accepts(network["host"], network["port"])
    held = shared_memory(ctl.processes())
    ctl("down")
    ctl.assert_nothing_left()
    ctl.assert_private()
    assert not accepts(network["host"], network["port"])
    assert [file for file in held if os.path.exists(file)] == []
    assert "not up" in ctl("down") and "not up" in ctl("status", status=1)
    assert "not up" in ctl("trace", status=1) and "bifrostd" in ctl("logs")


def test_a_shell_that_joined_outlives_down(ctl: Cli) -> None:
    ctl("up", "--profile", ctl.profile(BIFROST_ALONE))
    script = f"{ctl('env')}\nexec sleep 60"
    shell = subprocess.Popen(["/bin/sh", "-c", script])
    try:
        wait_until(lambda: any(p.pid == shell.pid for p in ctl.processes()), 10.0, "the shell has joined")
        ctl("down")
        assert shell.poll() is None
    finally:
        shell.kill()
        shell.wait()
    ctl.assert_nothing_left()


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_up_leaves_nothing(ctl: Cli, signum: signal.Signals) -> None:
    process = ctl.start("up", "--profile", ctl.profile(MOTION_SYSTEM))
    log = ctl.home / "default" / "logs" / "supervisord.log"
    wait_until(lambda: log.exists() and "spawned" in log.read_text(), PATIENCE, "the first process is spawned", 0.002)
    process.send_signal(signum)
    out, err = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 128 + signum, out + err
    assert err == f"valorctl: interrupted by {signum.name}\n"
    ctl.assert_nothing_left()


def test_a_failed_up_states_why_and_leaves_nothing(ctl: Cli) -> None:
    shutil.copytree(ROBOTS / "escher", ctl.home / "robot")
    broken = ctl.home / "robot" / "robot.yaml"
    broken.write_text(broken.read_text().replace("l_foot, sole: l_sole", "l_foot, sole: l_gripper"))
    output = ctl("up", "--profile", ctl.profile(MOTION_SYSTEM), "--robot", str(ctl.home / "robot"), status=1)
    assert "robot.yaml:19:" in output and "feet.left.sole" in output
    ctl.assert_nothing_left()


def homes_that_begin_alike(folder: Path) -> Iterator[Path]:
    """Homes whose instances would take the same domain, were they alone."""
    first = choose(str(folder / "0" / "x"), set(), lambda _: True)
    for number in itertools.count():
        home = folder / str(number)
        if choose(str(home / "x"), set(), lambda _: True) == first:
            yield home


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
