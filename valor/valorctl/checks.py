"""What can be wrong with a computer or an instance, looked for one by one."""

from __future__ import annotations

import contextlib
import getpass
import os
import platform
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import psutil

import bifrost
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.linking import NAMES, behind, ports_to_robot
from valor.common.priority import granted, own_core
from valor.common.processes import PROCESSES
from valor.common.resources import IN_CHECKOUT, REPAIR
from valor.drawing.errors import OFFSCREEN
from valor.valorctl import leftovers, ros_domain, supervisor_config
from valor.valorctl.health import SILENCE, Listener
from valor.valorctl.supervision import Supervisor

Level = Literal["ok", "warn", "fail"]

_LEAST_MEMORY = 1.5  # free, for a whole system [GiB]
_LEAST_TIME = 3600.0  # until the disk is full [s]
_LEAST_DISK = 2.0  # free, for bags [GiB]
_SUBPROCESS_TIMEOUT = 60.0  # [s]

_RENDER = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light pos='0 0 2'/><geom type='sphere' size='.3' rgba='1 1 1 1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = mujoco.Renderer(model, 48, 64)
renderer.update_scene(data)
assert renderer.render().max() > 0, "the picture is black"
"""
_ROS = """
import rclpy
import control_msgs.action, sensor_msgs.msg, tf2_msgs.msg, trajectory_msgs.msg
import valor_msgs.msg, vigir_footstep_planning_msgs.action, vigir_humanoid_control_msgs.action
"""


@dataclass(frozen=True)
class Finding:
    """What one look found."""

    check: str
    level: Level
    text: str
    advice: str = ""  # what to do about it
    host: str = ""  # where; empty: this computer


def run_all(instance: Instance, tell: Callable[[str], None] = lambda name: None) -> list[Finding]:
    """All checks, in the order in which one would look; ``tell`` is told which comes next."""
    findings = []
    for place, check in enumerate(CHECKS):
        tell(f"{place + 1} of {len(CHECKS)}: {check.__name__.strip('_').replace('_', ' ')}")
        findings.append(check(instance))
    return findings


def _python(_: Instance) -> Finding:
    version = platform.python_version()
    machine = platform.machine()
    if machine != "x86_64":
        return Finding("python", "warn", f"{version} on {machine}", "the ROS 2 wheels are built for x86_64")
    return Finding("python", "ok", f"{version} at {sys.executable}")


def _compiler(_: Instance) -> Finding:
    for name in filter(None, (os.environ.get("CXX"), "c++", "g++", "clang++")):
        if path := shutil.which(name):
            return Finding("compiler", "ok", path)
    return Finding("compiler", "warn", "no C++ compiler", "`make setup` compiles message packages: apt install g++")


def _rendering(_: Instance) -> Finding:
    problem = _run(_RENDER, MUJOCO_GL="egl")
    if problem:
        advice = f"pictures need EGL: apt install {' '.join(OFFSCREEN)}"
        return Finding("rendering", "fail", f"MuJoCo cannot draw off screen: {problem}", advice)
    return Finding("rendering", "ok", "MuJoCo draws off screen by EGL")


def _ros(_: Instance) -> Finding:
    problem = _run(_ROS)
    if problem:
        return Finding("ros", "fail", f"ROS 2 is not importable: {problem}", REPAIR)
    return Finding("ros", "ok", "rclpy and all message packages are importable")


def _run(program: str, **environment: str) -> str:
    """Run a Python program in a process of its own; returns the last line of its complaint, empty if all went well."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", program],
            env=os.environ | environment,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_SUBPROCESS_TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no end within {_SUBPROCESS_TIMEOUT:g} s"
    if done.returncode == 0:
        return ""
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    return lines[-1].strip() if lines else f"exit status {done.returncode}"


def _supervisor(instance: Instance) -> Finding:
    try:
        supervisor_config.socket_file(instance)
    except ValorError as error:
        return Finding("instance", "fail", str(error), "set VALOR_HOME to a shorter path")
    if not instance.settings_file.exists():
        return Finding("instance", "ok", f"{instance.name} is not up")
    if not Supervisor(instance).answers():
        text = f"{instance.name} has settings, but its supervisor does not answer"
        return Finding("instance", "fail", text, f"valorctl down --instance {instance.name}")
    return Finding("instance", "ok", f"{instance.name} is up")


def _keys(instance: Instance) -> Finding:
    if not instance.keys.exists():
        return Finding("keys", "ok", "none while the instance is down")
    wrong = []
    for folder in (instance.keys, instance.owners):
        for path in (folder, *sorted(folder.rglob("*"))) if folder.exists() else ():
            expected = 0o700 if path.is_dir() else 0o600
            if (mode := path.stat().st_mode & 0o777) != expected:
                wrong.append(f"{path} has mode {mode:04o} instead of {expected:04o}")
    if wrong:
        return Finding("keys", "fail", "; ".join(wrong), f"chmod -R go= {instance.keys} {instance.owners}")
    return Finding("keys", "ok", "readable by their owner alone")


def _ports(instance: Instance) -> Finding:
    if instance.network_file.exists():
        try:
            network = bifrost.Network.load(instance.network_file, instance.keys)
        except bifrost.Error as error:
            return Finding("ports", "fail", str(error), f"valorctl down --instance {instance.name}")
        if bifrost.daemon_alive(network, timeout=1.0) is None:
            text = f"bifrostd does not answer at {network.computer.daemon}"
            return Finding("ports", "fail", text, "valorctl logs bifrostd; valorctl restart bifrostd")
        return Finding("ports", "ok", f"bifrostd answers at {network.computer.daemon}")
    try:
        with ros_domain.reserve_for(instance) as reservation, socket.socket() as probe:
            domain = reservation.domain
            probe.bind(("127.0.0.1", 0))
    except (ValorError, OSError) as error:
        return Finding("ports", "fail", str(error), "stop other ROS 2 systems, or look at the firewall's rules")
    return Finding("ports", "ok", f"TCP ports are free on loopback, and ROS domain {domain}")


def _multicast(_: Instance) -> Finding:
    group, advice = "239.255.77.1", "ip link set lo multicast on"
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        try:
            receiver.bind((group, 0))
            loopback = socket.inet_aton("127.0.0.1")
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + loopback)
            receiver.settimeout(1.0)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            sender.sendto(b"valor", (group, receiver.getsockname()[1]))
            receiver.recv(16)
        except OSError as error:
            return Finding("multicast", "warn", f"multicast on loopback does not work: {error}", advice)
    return Finding("multicast", "ok", "works on loopback")


def _memory(_: Instance) -> Finding:
    free = psutil.virtual_memory().available / 2**30
    if free < _LEAST_MEMORY:
        return Finding("memory", "warn", f"{free:.1f} GiB free", f"a system wants {_LEAST_MEMORY:g} GiB")
    return Finding("memory", "ok", f"{free:.1f} GiB free")


def _disk(instance: Instance) -> Finding:
    folder = next(path for path in (instance.bags, *instance.bags.parents) if path.exists())
    if not os.access(folder, os.W_OK):
        return Finding("disk", "fail", f"{folder} is not writable", "set VALOR_HOME to a folder of yours")
    from valor.valorctl import recording_report

    try:
        ahead, limit = recording_report.prospect(instance)
    except ValorError as error:
        return Finding("disk", "fail", str(error), "remove the file; the next `up` writes it again")
    text = f"{ahead.free / 1e9:.1f} GB free under {folder}; {ahead.line()}"
    if ahead.free < _LEAST_DISK * 2**30:
        return Finding("disk", "warn", text, f"make room: {_LEAST_DISK:g} GiB are a start; `valorctl bag prune`")
    if ahead.seconds < _LEAST_TIME and not ahead.bounded:
        return Finding("disk", "warn", text, "nothing bounds a bag that was named by --bag: end it, or make room")
    if ahead.short:
        advice = f"the disk has no room for all that recordings may take ({limit}): make room, or a lower --bag-bound"
        return Finding("disk", "warn", text, advice)
    return Finding("disk", "ok", text)


def _processor(_: Instance) -> Finding:
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        return Finding("processor", "warn", f"{cores} core", "two carry the system in real time")
    governors = set()
    for file in Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor"):
        with contextlib.suppress(OSError):
            governors.add(file.read_text().strip())
    if slow := governors - {"performance", "schedutil"}:
        advice = "cpupower frequency-set -g performance steadies the control loop"
        return Finding("processor", "warn", f"{cores} cores, governor {', '.join(sorted(slow))}", advice)
    governor = ", ".join(sorted(governors)) or "not adjustable"
    own = [process.name for process in PROCESSES if process.cores == "own"]
    share = f"{' and '.join(own)} on core {own_core()} in simulation, and others off it"
    return Finding("processor", "ok", f"{cores} cores, governor {governor}; {share}")


def _real_time(_: Instance) -> Finding:
    priority, niceness = max(row.real_time for row in PROCESSES), min(row.priority for row in PROCESSES)
    real_time, nice = granted(priority, niceness)
    if real_time:
        return Finding("real time", "ok", f"control loops get SCHED_FIFO, priority {priority}")
    instead = f"at nice {niceness} on hardware, like all else in sim" if nice else "like all else"
    advice = (
        f"/etc/security/limits.d/valor.conf: `{getpass.getuser()} - rtprio {priority}` and `… - nice {niceness}`, then "
        "log in again; in a container: --cap-add SYS_NICE"
    )
    return Finding("real time", "warn", f"SCHED_FIFO is not granted: control loops run {instead}", advice)


def _leftovers(_: Instance) -> Finding:
    groups: dict[tuple[str, str], list[leftovers.Supervised]] = {}
    for process in leftovers.supervised_processes():
        groups.setdefault((process.home, process.instance), []).append(process)
    orphaned = [
        (home, name, len(members))
        for (home, name), members in groups.items()
        if not any("supervisor.supervisord" in member.command for member in members)
    ]
    if orphaned:
        text = ", ".join(f"{count} of instance {name} in {home}" for home, name, count in orphaned)
        advice = "; ".join(f"VALOR_HOME={home} valorctl down --instance {name}" for home, name, _ in orphaned)
        return Finding("leftovers", "fail", f"processes without a supervisor: {text}", advice)
    there = "1 instance is" if len(groups) == 1 else f"{len(groups)} instances are"
    return Finding("leftovers", "ok", f"none; {there} up on this computer")


def _link(instance: Instance) -> Finding:
    """Whether this computer's ends of the link hear the others, by what they say themselves."""
    settings = instance.settings() if instance.settings_file.exists() else None
    here = settings.processes_here(settings.asked) if settings is not None else ()
    names = [name for name in NAMES if name in here]
    if settings is None or not names:
        return Finding("link", "ok", "no end of one runs here")
    with Listener(instance, names) as listener:
        until = time.monotonic() + SILENCE
        while len(listener.words) < len(names) and time.monotonic() < until:
            listener.listen(0.1)
        said = {name: listener.words.get(name) for name in names}
        now = time.monotonic()
    wrong = [
        f"{name}: {'runs, but says nothing' if word is None else word.detail or word.state}"
        for name, word in said.items()
        if word is None or word.state != "ready" or now - word.heard > SILENCE
    ]
    if wrong:
        slow, fast = ports_to_robot(settings)
        advice = f"UDP, ports {slow} and {fast} of {settings.link.robot}, must lead to the robot's end"
        return Finding("link", "warn", "; ".join(wrong), advice)
    told = f"{' and '.join(names)}: the other end is heard"
    if behind(settings):
        told += f"; the operator's ROS domain is {settings.link.domain}"
    return Finding("link", "ok", told)


CHECKS: tuple[Callable[[Instance], Finding], ...] = (
    _python,
    *((_compiler,) if IN_CHECKOUT else ()),
    _ros,
    _rendering,
    _multicast,
    _processor,
    _real_time,
    _memory,
    _disk,
    _supervisor,
    _keys,
    _ports,
    _link,
    _leftovers,
)
