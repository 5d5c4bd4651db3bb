"""From up to down: what runs is seen, and nothing stays behind, also where up is interrupted or fails."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from harness.places import ROBOTS
from harness.turns import after, known, turns
from harness.waiting import wait_until
from tests.integration.valorctl.command_line import (
    BIFROST_ALONE,
    MOTION_SYSTEM,
    PATIENCE,
    TIMEOUT,
    VALORCTL,
    Cli,
    shared_memory,
)
from tests.unit.test_valorctl_help import HEAVY, imported
from valor.common.priority import take_turns


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


def soon(ctl: Cli) -> None:
    """Who asks waits for nothing that comes once a second: little more than its imports take."""
    imports = "import valor.valorctl.watch, valor.valorctl.status_view"

    def took(*command: str | Path) -> float:
        began = time.monotonic()
        subprocess.run(command, env=os.environ | {"VALOR_HOME": str(ctl.home)}, check=True, capture_output=True)
        return time.monotonic() - began

    assert any(took(VALORCTL, "status") < 2.5 * took(sys.executable, "-c", imports) for _ in range(3))


def lean(ctl: Cli) -> None:
    """It imports nothing that takes longer than looking does."""
    environment = os.environ | {"VALOR_HOME": str(ctl.home)}
    heavy = HEAVY | {"typer"}
    assert imported("status", environment=environment) & heavy == {"rich", "zmq"}
    assert imported("status", "--json", environment=environment) & heavy == {"zmq"}


def test_from_up_to_down_nothing_stays_behind(ctl: Cli) -> None:
    old = ctl.home / "default" / "logs" / "old.log"
    old.parent.mkdir(parents=True)
    old.write_text("of an up under another mask\n")
    told = ctl("up", "--profile", ctl.profile(MOTION_SYSTEM), "--actuators", "ideal", "--seed", "3")
    for name in ("bifrostd", "comms_manager", "motion_manager"):
        assert f"{name} ready" in told
    seen = ctl.status()
    printed = json.loads(ctl("status", "--json"))
    assert printed.keys() | {"services"} == seen.keys()
    assert [service["name"] for service in printed["services"]] == list(seen["services"])
    assert {name: service["state"] for name, service in seen["services"].items()} == {
        "bifrostd": "ready",
        "comms_manager": "ready",
        "motion_manager": "ready",
    }
    assert seen["robot"] == "escher"
    assert seen["behavior"]
    assert seen["clock"]["mode"] == "lockstep"
    factor = wait_until(
        lambda: ctl.status()["clock"]["real_time_factor_since_start"], 30.0, "robot time for a real-time factor"
    )
    assert 0 < factor <= 1
    for service in seen["services"].values():
        assert service["restarts"] == 0
        assert service["memory_mib"] > 10
        assert service["cpu_percent"] >= 0
    ctl.assert_private()
    assert "comms_manager" in ctl("status")
    traced = json.loads(ctl("trace", "--for", "2", "--json", "--plot", str(ctl.home / "trace.png")))
    assert traced["periods"] >= 3
    assert {part["title"].partition(":")[0] for part in traced["segments"]} >= {"comms_manager", "motion_manager"}
    assert traced["cost_percent"].keys() == {"comms_manager", "motion_manager"}
    assert (ctl.home / "trace.png").stat().st_size > 10_000
    if known():
        comms = ctl.pid("comms_manager")
        for thread in os.listdir(f"/proc/{comms}/task"):
            assert turns(int(thread)).length == after(lambda: take_turns("short")).length
    assert "pushed" in ctl("push", "-1.5", "0", "-.5")
    assert "finite" in ctl("push", "nan", "0", "0", status=2)
    assert "bifrostd" in ctl("logs", "-n", "300")
    watched(ctl)
    soon(ctl)
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
    assert "not up" in ctl("down")
    assert "not up" in ctl("status", status=1)
    assert "not up" in ctl("trace", status=1)
    assert "bifrostd" in ctl("logs")


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


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("robot.yaml", ("l_foot, sole: l_sole", "l_foot, sole: l_gripper"), ["robot.yaml:16:", "feet.left.sole"]),
        ("model.xml", ("<worldbody>", "<worldbody><nobody/>"), ["model.xml"]),
        ("get_up.yaml", ("face_down:", "face_up:"), ["get_up.yaml:8:1: face_up"]),
    ],
)
def test_a_failed_up_says_why_and_leaves_nothing(
    ctl: Cli, file: str, change: tuple[str, str], words: list[str]
) -> None:
    shutil.copytree(ROBOTS / "escher", ctl.home / "robot")
    broken = ctl.home / "robot" / file
    broken.write_text(broken.read_text().replace(*change))
    told = ctl("up", "--profile", ctl.profile(MOTION_SYSTEM), "--robot", str(ctl.home / "robot"), status=1)
    for word in words:
        assert word in told
    ctl.assert_nothing_left()
