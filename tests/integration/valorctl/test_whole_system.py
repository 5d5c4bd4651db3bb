"""The whole system, from up to down: it stands, reaches, walks and steps, is led by one alone, falls and is stopped."""

import json
import math
import os
import re
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import bifrost
from harness.bifrost_network import mechanism, ports
from harness.places import REPOSITORY
from harness.waiting import wait_until
from tests.integration.valorctl.command_line import PATIENCE, TIMEOUT, Cli, shared_memory
from valor.common import topics
from valor.common.instance import Instance
from valor.common.processes import BY_NAME
from valor.common.topics import BEHAVIOR, MOTION_STATE, MOTOR, PROPRIOCEPTOR, STATISTICS
from valor.valorctl.instance.profile import Profile
from valor.valorctl.status.health import REPORT_TIMEOUT


def one_walks_at_a_time(ctl: Cli) -> None:
    """Who comes second is refused; who is interrupted leaves a robot that comes to a stop by itself."""
    first = ctl.start("walk", "--vx", "0.2", "--for", "600")
    instance = Instance("default", ctl.home)
    network = bifrost.Network.load(instance.network_file, instance.keys)
    with bifrost.Node("observer", network=network) as node:
        states = MOTION_STATE.subscriber(node)

        def speed() -> float | None:
            state = states.latest()
            return None if state is None else float(np.linalg.norm(state.message.pelvis_linear_velocity_in_odom))

        wait_until(lambda: (speed() or 0.0) > 0.15, TIMEOUT, "walking")
        assert "another client already publishes /cmd_vel" in ctl("walk", "--vx", "-0.2", status=1)
        assert first.poll() is None
        first.send_signal(signal.SIGINT)
        assert "interrupted by SIGINT" in first.communicate(timeout=TIMEOUT)[1]
        assert first.returncode == 128 + signal.SIGINT
        wait_until(lambda: (now := speed()) is not None and now < 0.005, TIMEOUT, "the robot at rest")
    assert "control mode is stand_manipulate" in ctl("mode", "stand_manipulate")


def one_writer(ctl: Cli) -> None:
    """With the keys that all members share, and with those of the recorder, nobody leads the robot or lies to it."""
    instance = Instance("default", ctl.home)
    refused_before = refusals(instance)
    for owner in ("", "bag_recorder"):
        network = topics.network(instance, owner)
        with (
            bifrost.Node("evil", network=network) as honest,
            pytest.raises(bifrost.Error, match=r"^evil may not publish motion_manager/motor, which belongs"),
        ):
            MOTOR.publisher(honest)
        blind = replace(network, grants=bifrost.Grants({"bifrostd": network.grants.owners["bifrostd"]}))
        with bifrost.Node("evil", network=blind) as evil, bifrost.Node("watching", network=network) as watching:
            forged_motors = MOTOR.publisher(evil)
            forged_states = PROPRIOCEPTOR.publisher(evil)
            motors = MOTOR.subscriber(watching)
            states = PROPRIOCEPTOR.subscriber(watching)
            until = time.monotonic() + 1.0
            while time.monotonic() < until:
                motor, state = motors.receive(5.0), states.receive(5.0)
                assert motor and state and {motor.origin, state.origin} == {"motion_manager", "comms_manager"}
                limp, now = np.zeros_like(motor.message.mode), time.monotonic_ns()
                answers = state.message.sequence
                forged_motors.publish(
                    msgspec.structs.replace(motor.message, mode=limp, writer=now, proprioceptor_sequence=answers)
                )
                forged_states.publish(msgspec.structs.replace(state.message, sequence=answers + 10))
            publishers = {
                topic: watching.graph().topics[topic].publishers for topic in (MOTOR.name, PROPRIOCEPTOR.name)
            }
            assert [[end.node for end in ends] for ends in publishers.values()] == [
                ["motion_manager"],
                ["comms_manager"],
            ]
        said = (instance.logs / "bifrostd.log").read_text()
        for refused in (
            "motion_manager/motor, which belongs to motion_manager",
            "comms_manager/proprioceptor, which belongs to comms_manager",
        ):
            assert re.search(rf"evil may not publish {refused}: rejected .*key of {owner or 'member'}", said)
    assert "evil may not publish" in ctl("status")
    assert refusals(instance) == refused_before  # none of theirs came that far
    assert ctl.status()["behavior"] == "stand_manipulate"


def refusals(instance: Instance) -> int:
    """How many Motors and Proprioceptors their readers have refused."""
    with bifrost.Node("test", network=topics.network(instance)) as node:
        words = [STATISTICS[name].subscriber(node) for name in ("comms_manager", "motion_manager")]
        received = [word.receive(5.0) for word in words]
        assert all(received)
        return sum(word.message.rejected for word in received if word)


def without_supervisor(ctl: Cli) -> None:
    """What runs obeys, and is shown."""
    os.kill(ctl.supervisord(), signal.SIGKILL)
    assert "accepted" in ctl("mode", "soft_stop") and "accepted" in ctl("mode", "stand")
    assert json.loads(ctl("stop", "--json"))["state"] == "soft_stop"
    assert "supervisor does not respond" in ctl("status", status=1)
    seen = ctl.status()
    assert not seen["supervised"] and {service["state"] for service in seen["services"].values()} == {"ready"}
    assert seen["way_out"] == "valorctl mode stand"


def whoever_dies_a_stop_reports_the_truth(ctl: Cli) -> None:
    """Nobody restarts anything; the robot lies on the floor."""

    def stopped(*options: str, status: int = 0) -> str:
        said = ctl("stop", *options, status=status)
        for path in (
            "motion_manager, over Bifrost: ",
            "comms_manager, over Bifrost: ",
            "valor_ros_controller, over ROS 2: ",
        ):
            assert path in said
        return said.splitlines()[0]

    names = ("bifrostd", "motion_manager", "comms_manager", "valor_ros_controller")
    bifrostd, motion_manager, comms_manager, controller = (ctl.pid(name) for name in names)
    assert stopped().endswith(": fall")
    os.kill(motion_manager, signal.SIGSTOP)
    assert stopped("--freeze").endswith(": freeze"), "the Comms Manager holds what a silent one has left"
    os.kill(motion_manager, signal.SIGCONT)
    assert stopped("--freeze").endswith(": freeze"), "and it does not undo it"
    for pid in (bifrostd, controller):
        os.kill(pid, signal.SIGKILL)
    assert stopped("--freeze").endswith(": freeze"), "its last table leads there"
    os.kill(motion_manager, signal.SIGKILL)
    assert stopped("--freeze").endswith(": freeze")
    os.kill(comms_manager, signal.SIGKILL)
    assert "comms_manager does not publish" in stopped(status=1)


def time_is_paused(ctl: Cli) -> None:
    """Nothing has failed, and the command that resumes time is named."""
    ctl("time", "pause")
    began = time.monotonic()

    def late() -> dict[str, Any] | None:
        seen = ctl.status()
        assert {service["state"] for service in seen["services"].values()} == {"ready"}
        return seen if time.monotonic() - began > 2.0 * REPORT_TIMEOUT else None

    seen = wait_until(late, PATIENCE, "reports are late", 1.0)
    assert (seen["clock"]["mode"], seen["way_out"]) == ("paused", "valorctl time resume")
    ctl(*seen["way_out"].split()[1:])
    wait_until(lambda: ctl.status()["way_out"] is None, PATIENCE, "time passes")


def gets_up_or_says_why_not_and_is_reset(ctl: Cli) -> None:
    """Felled aside it lies on a side or its back: it gets up, or that it cannot is said with the way that works."""
    ctl("push", "0", "300", "0")
    wait_until(lambda: ctl.status()["fallen"], PATIENCE, "the fall is seen", 0.5)
    rising = ctl.start("get-up")
    out, err = rising.communicate(timeout=TIMEOUT)
    assert ("up again" in out) if rising.returncode == 0 else ("`valorctl reset`" in err), out + err
    ctl("reset")
    seen = ctl.status()
    assert (seen["control_mode"], seen["behavior"], seen["way_out"]) == ("stand", "stand", None)


def fallen(ctl: Cli) -> None:
    """Why, since when, what to do, and where it is recorded."""
    ctl("push", "0", "300", "0")

    def recorded() -> dict[str, Any] | None:
        seen = ctl.status()
        return seen if seen["fallen"] and seen["bag"] else None  # the recorder writes twice a second

    seen = wait_until(recorded, PATIENCE, "the fall is seen and recorded", 0.5)
    assert seen["reason"] and seen["since_s"] > 0 and seen["way_out"] == "valorctl reset"
    assert seen["bag"] == str(ctl.home / "whole.mcap")


def stands(ctl: Cli, bag: Path, reported: str) -> None:
    """All is up as the profile has it, recorded, and for nobody else to read or to join."""
    assert "control mode stand" in reported
    assert re.search(rf"recording to {bag}: \d+\.\d MB/s, in .* the disk is full", reported)
    seen = ctl.status()
    assert seen["recording"]["bag"] == str(bag) and seen["recording"]["bytes"] > 0
    assert {service["state"] for service in seen["services"].values()} == {"ready"}
    processes = Profile.load(REPOSITORY / "deploy" / "sim.yaml").processes
    assert set(seen["services"]) == set(processes)
    assert (seen["control_mode"], seen["behavior"], seen["profile"]) == ("stand", "stand", "sim")

    ctl.assert_private(bag)
    listening = [port for process in ctl.processes() for port in ports(process.pid)]
    assert len(listening) >= len(processes) and {mechanism(port) for port in listening} == {"CURVE"}


def tables_are_shown(ctl: Cli) -> None:
    """What topics.py and processes.py say stands beside what there is."""
    seen = ctl.status()["services"]["motion_manager"]
    assert (seen["needs"], seen["cpu_budget_percent"]) == (["bifrostd"], BY_NAME["motion_manager"].cpu_budget)
    [motor] = [topic for topic in json.loads(ctl("topic", "list", "--json")) if topic["name"] == MOTOR.name]
    assert motor["catalogue"]["rate_hz"] == 500.0 and motor["catalogue"]["may_publish"] == ["motion_manager"]
    [line] = [line for line in ctl("topic", "list").splitlines() if line.startswith(MOTOR.name)]
    assert line.split()[1:3] == ["Motor", "motion_manager"] and line.endswith(f"500  {MOTOR.description}")
    assert f"description: {MOTOR.description}" in ctl("topic", "info", MOTOR.name)
    assert BEHAVIOR.description in ctl("service", "list")


def arms_obey(ctl: Cli) -> None:
    """In the mode that lets them, and then go where they are commanded."""
    refused = ctl("arm", "left", "forward", status=1)
    assert "left_arm_traj_controller" in refused and "stand_manipulate" in refused
    assert "MODE_ACCEPTED" in ctl("mode", "stand_manipulate") and "already" in ctl("mode", "stand_manipulate")
    assert "expected one of" in ctl("mode", "backflip", status=1)
    assert "carry the robot" in ctl("mode", "freeze", "--joints", "left_leg", status=1)
    assert "accepted: freeze left_arm" in ctl("mode", "freeze", "--joints", "left_arm")
    assert "frozen: left_arm" in ctl("status") and "accepted" in ctl("mode", "freeze", "--joints", "none")
    shown = json.loads(ctl("mode", "--json"))
    assert (shown["control_mode"], shown["behavior"]) == ("stand_manipulate", "stand_manipulate")
    assert "forward" in ctl("arm", "left", "backflip", status=1)
    moved = json.loads(ctl("arm", "left", "forward", "--json"))
    assert moved["arrived"] and abs(moved["worst_error_rad"]) < moved["tolerance_rad"]


def walks(ctl: Cli) -> None:
    """At a velocity, for a while, without falling."""
    walked = json.loads(ctl("walk", "--vx", "0.3", "--for", "4", "--json"))
    assert not walked["fell"] and 0.5 < walked["distance_m"] < 2.0 and walked["mean_dcm_error_m"] < 0.03
    assert "finite" in ctl("walk", "--vx", "nan", status=2)


def steps(ctl: Cli) -> None:
    """Steps to a goal."""
    stepped = json.loads(ctl("step", "--to", "0.25", "0.05", "0.2", "--relative", "--json"))
    assert stepped["reached"] and stepped["largest_error_m"] < 0.03
    assert stepped["largest_error_rad"] < math.radians(3.0)
    assert "finite" in ctl("step", "--to", "nan", "0", "0", status=2)
    assert json.loads(ctl("mode", "--json"))["control_mode"] == "stand_manipulate"


@pytest.mark.timeout(600)
def test_the_whole_system_stands_moves_and_goes(ctl: Cli) -> None:
    bag = ctl.home / "whole.mcap"
    stands(ctl, bag, ctl("up", "--bag", str(bag)))
    tables_are_shown(ctl)
    arms_obey(ctl)
    walks(ctl)
    one_walks_at_a_time(ctl)
    steps(ctl)
    one_writer(ctl)
    time_is_paused(ctl)
    gets_up_or_says_why_not_and_is_reset(ctl)
    without_supervisor(ctl)
    fallen(ctl)
    held = shared_memory(ctl.processes())
    whoever_dies_a_stop_reports_the_truth(ctl)
    assert re.search(rf"recorded {bag}: \d+\.\d MB, \d+", ctl("down"))
    ctl.assert_nothing_left()
    assert [file for file in held if os.path.exists(file)] == []
    ctl.assert_private(bag)
    info = json.loads(ctl("bag", "info", str(bag), "--json"))
    assert {"/joint_states", "/bifrost/motion_manager/motor"} <= {topic["name"] for topic in info["topics"]}
