"""valorctl with a real supervisord: up, watch, down, and that nothing stays behind whatever happens in between."""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec
import numpy as np
import psutil
import pytest

import bifrost
from harness.bifrost_network import mechanism, ports
from harness.places import REPOSITORY, ROBOTS
from harness.turns import after, known, turns
from harness.waiting import wait_until
from tests.unit.test_ros_domain import homes_that_begin_alike
from tests.unit.test_valorctl_help import HEAVY, imported
from valor.common import membership
from valor.common.instance import Instance
from valor.common.priority import take_turns
from valor.common.topics import MOTION_STATE, MOTOR, PROPRIOCEPTOR, STATISTICS
from valor.valorctl.profile import Profile
from valor.valorctl.ros_domain import is_reserved
from valor.valorctl.watch import look

VALORCTL = Path(sys.executable).with_name("valorctl")
TIMEOUT = 120.0  # of one call [s]
PATIENCE = 60.0  # [s]
BIFROST_ALONE = "description: the name service\nprocesses: [bifrostd]\n"
MOTION_SYSTEM = "description: no ROS\nprocesses: [bifrostd, comms_manager, motion_manager]\n"


@dataclass
class Cli:
    """Calls valorctl as a user would: from another folder, with nothing of ours in the environment but the home."""

    home: Path
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("VALOR_", "BIFROST_", "ROS_"))}
        process = subprocess.Popen(
            [VALORCTL, *arguments],
            env=environment | {"VALOR_HOME": str(self.home)},
            cwd="/",
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            umask=0o022,
        )
        self.started.append(process)
        return process

    def __call__(self, *arguments: str, status: int = 0) -> str:
        """Its standard output, or when ``status`` is not 0 its standard error."""
        process = self.start(*arguments)
        out, err = process.communicate(timeout=TIMEOUT)
        assert process.returncode == status, f"{arguments} ended with {process.returncode}: {out}{err}"
        assert "Traceback" not in err
        if status == 0:
            return out
        assert status == 2 or err.startswith("valorctl: "), err
        return err

    def status(self, instance: str = "default") -> dict[str, dict[str, object]]:
        """What ``status --json`` prints, with the services by name."""
        content = look(Instance(instance, self.home)).as_json()
        return content | {"services": {service["name"]: service for service in content["services"]}}

    def pid(self, service: str, instance: str = "default") -> int:
        pid = self.status(instance)["services"][service]["pid"]
        assert isinstance(pid, int)
        return pid

    def supervisord(self, instance: str = "default") -> int:
        return int((self.home / instance / "supervisord.pid").read_text())

    def profile(self, text: str) -> str:
        file = self.home / f"profile-{len(list(self.home.glob('profile-*')))}.yaml"
        file.write_text(text)
        return str(file)

    def processes(self) -> list[psutil.Process]:
        """Every process whose environment names this home, but for valorctl itself."""
        found = []
        for process in psutil.process_iter():
            try:
                if process.environ().get("VALOR_HOME") == str(self.home) and process.status() != "zombie":
                    found.append(process)
            except psutil.Error:
                continue
        ours = {process.pid for process in self.started if process.poll() is None}
        return [process for process in found if process.pid not in ours]

    def assert_private(self, *others: Path) -> None:
        """Nobody but their user may read or write, or look into, what is an instance's."""
        files = [path for path in (self.home / "default").rglob("*") if not path.is_symlink()]
        assert [str(path) for path in (self.home / "default", *files, *others) if path.stat().st_mode & 0o077] == []

    def assert_nothing_left(self, instance: str = "default") -> None:
        """Processes, sockets, files: only logs and bags stay."""
        assert [" ".join(p.cmdline()) for p in self.processes()] == []
        left = {path.name for path in (self.home / instance).iterdir()} if (self.home / instance).exists() else set()
        assert left <= {"logs", "bags"}


@pytest.fixture
def ctl(home: Path) -> Iterator[Cli]:
    cli = Cli(home)
    try:
        yield cli
    finally:
        for process in cli.started:
            process.kill()
            process.communicate()
        for process in cli.processes():
            process.kill()


def accepts(host: str, port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((host, port)) == 0


def shared_memory(processes: list[psutil.Process]) -> set[str]:
    """What they hold but for LTTng's, which are the user's: one for all programs that can be traced."""
    lines = [line for p in processes for line in Path(f"/proc/{p.pid}/maps").read_text().splitlines()]
    return {line[line.index("/dev/shm/") :] for line in lines if "/dev/shm/" in line and "lttng" not in line}


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


def test_killed_restarted_and_silent_processes_are_seen_as_such(ctl: Cli) -> None:
    ctl("up", "--profile", ctl.profile(MOTION_SYSTEM))
    before = ctl.pid("motion_manager")
    os.kill(before, signal.SIGKILL)

    def back() -> bool:
        service = ctl.status()["services"]["motion_manager"]
        return service["state"] == "ready" and service["pid"] != before

    wait_until(back, PATIENCE, "motion_manager is ready again")
    services = ctl.status()["services"]
    assert {name: service["restarts"] for name, service in services.items()} == {
        "bifrostd": 0,
        "comms_manager": 0,
        "motion_manager": 1,
    }
    after = services["motion_manager"]["pid"]
    told = ctl("restart", "motion_manager")
    assert ctl.pid("motion_manager") != after
    assert str(ctl.pid("motion_manager")) in told
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
    """Whether a socket now listens where another one did."""
    try:
        thief.bind(address)
    except OSError:
        return False
    thief.listen()
    return True


def test_what_is_killed_comes_back_and_down_clears_up_behind_a_killed_supervisor(ctl: Cli) -> None:
    profile = ctl.profile(BIFROST_ALONE)
    ctl("up", "--profile", profile)
    a_name_service_whose_port_is_taken_meanwhile_comes_back(ctl)
    os.kill(ctl.supervisord(), signal.SIGKILL)
    assert "valorctl down" in ctl("status", status=1)
    assert ctl.processes()
    ctl("down")
    ctl.assert_nothing_left()


def test_up_clears_up_behind_a_killed_supervisor(ctl: Cli) -> None:
    profile = ctl.profile(BIFROST_ALONE)
    ctl("up", "--profile", profile)
    before = ctl.pid("bifrostd")
    os.kill(ctl.supervisord(), signal.SIGKILL)
    assert "crashed" in ctl("up", "--profile", profile)
    assert ctl.pid("bifrostd") != before
    ctl("down")
    ctl.assert_nothing_left()


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
        ("robot.yaml", ("l_foot, sole: l_sole", "l_foot, sole: l_gripper"), ["robot.yaml:15:", "feet.left.sole"]),
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


def one_walks_at_a_time(ctl: Cli) -> None:
    """Who comes second is refused; who is interrupted leaves a robot that comes to a stop by itself."""
    first = ctl.start("walk", "--vx", "0.2", "--for", "600")
    instance = Instance("default", ctl.home)
    network = bifrost.Network.load(instance.network_file, instance.keys)
    with bifrost.Node("observer", network=network) as node:
        states = MOTION_STATE.subscriber(node)

        def speed() -> float | None:
            state = states.latest()
            return state and float(np.linalg.norm(state.message.pelvis_linear_velocity_in_odom))

        wait_until(lambda: (speed() or 0.0) > 0.15, TIMEOUT, "walking")
        assert "walked already: velocities come from valorctl" in ctl("walk", "--vx", "-0.2", status=1)
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
        network = membership.network(instance, owner)
        with (
            bifrost.Node("evil", network=network) as honest,
            pytest.raises(bifrost.Error, match=r"^evil wants to publish motion_manager/motor, which is motion_manag"),
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
            "motion_manager/motor, which is motion_manager",
            "comms_manager/proprioceptor, which is comms_manager",
        ):
            assert re.search(rf"evil wants to publish {refused}'s: refused .*key of {owner or 'member'}", said)
    assert "evil wants to publish" in ctl("status")
    assert refusals(instance) == refused_before  # none of theirs came that far
    assert ctl.status()["behavior"] == "stand_manipulate"


def refusals(instance: Instance) -> int:
    """How many Motors and Proprioceptors their readers have refused."""
    with bifrost.Node("test", network=membership.network(instance)) as node:
        words = [STATISTICS[name].subscriber(node) for name in ("comms_manager", "motion_manager")]
        received = [word.receive(5.0) for word in words]
        assert all(received)
        return sum(word.message.rejected for word in received if word)


def without_supervisor(ctl: Cli) -> None:
    """What runs obeys, and is shown."""
    os.kill(ctl.supervisord(), signal.SIGKILL)
    assert "accepted" in ctl("mode", "soft_stop")
    assert "accepted" in ctl("mode", "stand")
    assert json.loads(ctl("stop", "--json"))["state"] == "soft_stop"
    assert "nothing restarts" in ctl("status", status=1)
    seen = ctl.status()
    assert not seen["supervised"]
    assert {service["state"] for service in seen["services"].values()} == {"ready"}
    assert seen["way_out"] == "valorctl mode stand"


def whoever_dies_a_stop_tells_the_truth(ctl: Cli) -> None:
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
    assert "comms_manager is silent" in stopped(status=1)


def fallen(ctl: Cli) -> None:
    """Why, since when, what to do, and where it is recorded."""
    ctl("push", "0", "300", "0")

    def recorded() -> dict[str, object] | None:
        seen = ctl.status()
        return seen if seen["fallen"] and seen["bag"] else None  # the recorder writes twice a second

    seen = wait_until(recorded, PATIENCE, "the fall is seen and recorded", 0.5)
    assert seen["reason"]
    assert seen["since_s"] > 0
    assert seen["way_out"] == "valorctl get-up"
    assert seen["bag"] == str(ctl.home / "whole.mcap")


@pytest.mark.timeout(600)
def test_the_whole_system_stands_moves_and_goes(ctl: Cli) -> None:
    told = ctl("up", "--bag", str(ctl.home / "whole.mcap"))
    assert "control mode stand" in told
    bag = ctl.home / "whole.mcap"
    assert re.search(rf"recording to {bag}: \d+\.\d MB/s, in .* the disk is full", told)
    seen = ctl.status()
    assert seen["recording"]["bag"] == str(bag) and seen["recording"]["bytes"] > 0
    assert {service["state"] for service in seen["services"].values()} == {"ready"}
    processes = Profile.load(REPOSITORY / "deploy" / "sim.yaml").processes
    assert set(seen["services"]) == set(processes)
    assert (seen["control_mode"], seen["behavior"], seen["profile"]) == ("stand", "stand", "sim")

    ctl.assert_private(bag)
    listening = [port for process in ctl.processes() for port in ports(process.pid)]
    assert len(listening) >= len(processes)
    assert {mechanism(port) for port in listening} == {"CURVE"}

    refused = ctl("arm", "left", "forward", status=1)
    assert "left_arm_traj_controller" in refused
    assert "stand_manipulate" in refused
    assert "MODE_ACCEPTED" in ctl("mode", "stand_manipulate")
    assert "already" in ctl("mode", "stand_manipulate")
    assert "expected one of" in ctl("mode", "backflip", status=1)
    shown = json.loads(ctl("mode", "--json"))
    assert (shown["control_mode"], shown["behavior"]) == ("stand_manipulate", "stand_manipulate")
    assert "forward" in ctl("arm", "left", "backflip", status=1)
    moved = json.loads(ctl("arm", "left", "forward", "--json"))
    assert moved["arrived"]
    assert abs(moved["worst_error_rad"]) < moved["tolerance_rad"]
    assert "motion_manager/motor" in ctl("topic", "list")
    walked = json.loads(ctl("walk", "--vx", "0.3", "--for", "4", "--json"))
    assert not walked["fell"]
    assert 0.5 < walked["distance_m"] < 2.0
    assert walked["mean_dcm_error_m"] < 0.03
    assert 0.0 < max(walked["dcm_error_rms_m"].values()) < 0.05
    assert 0.3 < walked["smallest_knee_angle_rad"] < 1.2
    assert 0.0 < walked["foot_force_error_rms_n"] < 150.0
    assert walked["solver_failures"] == 0
    assert 1500 < walked["ticks"] == pytest.approx(walked["duration_s"] * 500.0, rel=0.2)
    assert "finite" in ctl("walk", "--vx", "nan", status=2)
    one_walks_at_a_time(ctl)
    picture = ctl.home / "steps.png"
    stepped = json.loads(ctl("step", "--to", "0.25", "0.05", "0.2", "--relative", "--plot", str(picture), "--json"))
    assert stepped["reached"]
    assert stepped["largest_error_m"] < 0.03
    assert stepped["largest_error_rad"] < math.radians(3.0)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "finite" in ctl("step", "--to", "nan", "0", "0", status=2)
    assert json.loads(ctl("mode", "--json"))["control_mode"] == "stand_manipulate"

    program = "import os, rclpy; rclpy.init(); node = rclpy.create_node('peer'); print(os.environ['ROS_DOMAIN_ID'])\n"
    program += "from sensor_msgs.msg import JointState; heard = []\n"
    program += "node.create_subscription(JointState, '/joint_states', heard.append, 1)\n"
    program += "while not heard: rclpy.spin_once(node)\n"
    joined = f'{ctl("env")}\nexec "{sys.executable}" -c "{program}"'
    subprocess.run(["/bin/sh", "-c", joined], check=True, timeout=TIMEOUT)

    one_writer(ctl)
    without_supervisor(ctl)
    fallen(ctl)
    held = shared_memory(ctl.processes())
    whoever_dies_a_stop_tells_the_truth(ctl)
    assert re.search(rf"recorded {bag}: \d+\.\d MB, \d+", ctl("down"))
    ctl.assert_nothing_left()
    assert [file for file in held if os.path.exists(file)] == []
    ctl.assert_private(bag)
    info = json.loads(ctl("bag", "info", str(bag), "--json"))
    assert {"/joint_states", "/bifrost/motion_manager/motor"} <= {topic["name"] for topic in info["topics"]}
