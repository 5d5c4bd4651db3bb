"""What is killed comes back, or is cleared up; what is silent is seen as such."""

import json
import os
import signal
import socket

from harness.waiting import wait_until
from tests.integration.valorctl.command_line import BIFROST_ALONE, MOTION_SYSTEM, PATIENCE, Cli


def test_killed_restarted_and_silent_processes_are_seen_as_such(ctl: Cli) -> None:
    ctl("up", "--profile", ctl.profile(MOTION_SYSTEM))
    before = ctl.pid("motion_manager")
    os.kill(before, signal.SIGKILL)

    def back() -> bool:
        service = ctl.status()["services"]["motion_manager"]
        return bool(service["state"] == "ready" and service["pid"] != before)

    wait_until(back, PATIENCE, "motion_manager is ready again")
    services = ctl.status()["services"]
    assert {name: service["restarts"] for name, service in services.items()} == {
        "bifrostd": 0, "comms_manager": 0, "motion_manager": 1,
    }  # fmt: skip
    after = services["motion_manager"]["pid"]
    output = ctl("restart", "motion_manager")
    assert ctl.pid("motion_manager") != after and str(ctl.pid("motion_manager")) in output
    assert ctl.status()["services"]["motion_manager"]["restarts"] == 1
    assert "comms_manager" in ctl("restart", "commz", status=1)

    # What runs but is silent is not ready, and a stopped process does not hear SIGTERM.
    os.kill(ctl.pid("motion_manager"), signal.SIGSTOP)
    wait_until(lambda: ctl.status()["services"]["motion_manager"]["state"] == "failed", PATIENCE, "its silence is seen")
    ctl("down")
    ctl.assert_nothing_left()


def a_name_service_whose_port_is_taken_meanwhile_comes_back(ctl: Cli) -> None:
    computer = json.loads((ctl.home / "default" / "network.json").read_text())["computers"][0]
    log = ctl.home / "default" / "logs" / "bifrostd.log"
    with socket.socket() as thief:
        thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        pid = ctl.pid("bifrostd")
        os.kill(pid, signal.SIGKILL)
        wait_until(lambda: takes(thief, (computer["host"], computer["port"])), PATIENCE, "its port is free", 0.0)
        wait_until(lambda: log.read_text().count("cannot listen") >= 2, PATIENCE, "it is tried again")
    wait_until(lambda: ctl.status()["services"]["bifrostd"]["state"] == "ready", PATIENCE, "it is back")


def takes(thief: socket.socket, address: tuple[str, int]) -> bool:
    """Return whether a socket now listens where another one did."""
    try:
        thief.bind(address)
    except OSError:
        return False
    thief.listen()
    return True


def test_what_is_killed_comes_back_and_up_and_down_clear_up_behind_a_killed_supervisor(ctl: Cli) -> None:
    profile = ctl.profile(BIFROST_ALONE)
    ctl("up", "--profile", profile)
    a_name_service_whose_port_is_taken_meanwhile_comes_back(ctl)
    before = ctl.pid("bifrostd")
    os.kill(ctl.supervisord(), signal.SIGKILL)
    assert "valorctl down" in ctl("status", status=1) and ctl.processes()
    assert "crashed" in ctl("up", "--profile", profile) and ctl.pid("bifrostd") != before
    os.kill(ctl.supervisord(), signal.SIGKILL)
    ctl("down")
    ctl.assert_nothing_left()
