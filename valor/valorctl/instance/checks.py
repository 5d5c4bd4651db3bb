"""Checks of a computer and an instance for known problems."""

import getpass
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import bifrost
from valor.bags import recordings, retention
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.linking import NAMES, behind, ports_to_robot, robots_hosts
from valor.common.priority import granted, own_core
from valor.common.processes import PROCESSES, SENSORS
from valor.common.resources import REPAIR
from valor.drawing import OFFSCREEN
from valor.robot.description import RobotDescription
from valor.valorctl.instance import ros_domain, running, supervisor_config
from valor.valorctl.instance.supervision import Supervisor
from valor.valorctl.status.health import REPORT_TIMEOUT, Listener

Level = Literal["ok", "warn", "fail"]
Outcome = tuple[Level, str] | tuple[Level, str, str]  # with text, and advice

_LEAST_TIME = 3600.0  # until the disk is full [s]
_LEAST_DISK = 2.0  # free disk space for bags [GiB]
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
    """Result of one check; ``advice`` is the remedy, ``host`` is empty for this computer."""

    check: str
    level: Level
    text: str
    advice: str = ""
    host: str = ""


def run_all(instance: Instance, tell: Callable[[str], None] = lambda name: None) -> list[Finding]:
    """Run all checks; ``tell`` receives the name of each before it runs."""
    findings = []
    for name, check in CHECKS.items():
        tell(name)
        findings.append(Finding(name, *check(instance)))
    return findings


def _rendering(_: Instance) -> Outcome:
    problem = _run(_RENDER, MUJOCO_GL="egl")
    if problem:
        advice = f"pictures need EGL: apt install {' '.join(OFFSCREEN)}"
        return "fail", f"MuJoCo cannot draw off screen: {problem}", advice
    return "ok", "MuJoCo draws off screen by EGL"


def _ros(_: Instance) -> Outcome:
    problem = _run(_ROS)
    if problem:
        return "fail", f"ROS 2 is not importable: {problem}", REPAIR
    return "ok", "rclpy and all message packages are importable"


def _run(program: str, **environment: str) -> str:
    """Run a Python program in a new process; returns the last line of its errors, empty after success."""
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


def _supervisor(instance: Instance) -> Outcome:
    try:
        supervisor_config.socket_file(instance)
    except ValorError as error:
        return "fail", str(error), "set VALOR_HOME to a shorter path"
    if not instance.settings_file.exists():
        return "ok", f"{instance.name} is not up"
    if not Supervisor(instance).answers():
        text = f"{instance.name} has settings, but its supervisor does not respond"
        return "fail", text, f"valorctl down --instance {instance.name}"
    return "ok", f"{instance.name} is up"


def _keys(instance: Instance) -> Outcome:
    if not instance.keys.exists():
        return "ok", "none while the instance is not up"
    wrong = []
    for folder in (instance.keys, instance.owners):
        for path in (folder, *sorted(folder.rglob("*"))) if folder.exists() else ():
            expected = 0o700 if path.is_dir() else 0o600
            if (mode := path.stat().st_mode & 0o777) != expected:
                wrong.append(f"{path} has mode {mode:04o} instead of {expected:04o}")
    if wrong:
        return "fail", "; ".join(wrong), f"chmod -R go= {instance.keys} {instance.owners}"
    return "ok", "readable only by their owner"


def _ports(instance: Instance) -> Outcome:
    if instance.network_file.exists():
        try:
            network = bifrost.Network.load(instance.network_file, instance.keys)
        except bifrost.Error as error:
            return "fail", str(error), f"valorctl down --instance {instance.name}"
        if bifrost.daemon_alive(network, timeout=1.0) is None:
            text = f"bifrostd does not respond at {network.computer.daemon}"
            return "fail", text, "valorctl logs bifrostd; valorctl restart bifrostd"
        return "ok", f"bifrostd responds at {network.computer.daemon}"
    try:
        with ros_domain.reserve_for(instance) as reservation, socket.socket() as probe:
            domain = reservation.domain
            probe.bind(("127.0.0.1", 0))
    except (ValorError, OSError) as error:
        return "fail", str(error), "stop other ROS 2 systems, or check the firewall's rules"
    return "ok", f"TCP ports are free on loopback, and ROS domain {domain}"


def _multicast(_: Instance) -> Outcome:
    loopback = socket.inet_aton("127.0.0.1")
    group = "239.255.77.1"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((group, 0))
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + loopback)
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            probe.settimeout(1.0)
            probe.sendto(b"valor", probe.getsockname())
            probe.recv(16)
        except OSError as error:
            return "warn", f"multicast on loopback does not work: {error}", "ip link set lo multicast on"
    return "ok", "works on loopback"


def _disk(instance: Instance) -> Outcome:
    folder = next(path for path in (instance.bags, *instance.bags.parents) if path.exists())
    if not os.access(folder, os.W_OK):
        return "fail", f"{folder} is not writable", "set VALOR_HOME to a folder of yours"
    from valor.valorctl.recordings.recording_report import outlook

    up = instance.settings_file.exists()
    try:
        bounds = instance.settings().recording.bounds if up else retention.saved_bounds(instance.bags)
    except ValorError as error:
        return "fail", str(error), "remove the file; the next `up` writes it again"
    ahead = outlook(instance, bounds, recordings.being_written(instance.folder) if up else None)
    text = f"{ahead.free / 1e9:.1f} GB free under {folder}; {ahead.line()}"
    if ahead.free < _LEAST_DISK * 2**30:
        return "warn", text, f"free at least {_LEAST_DISK:g} GiB; `valorctl bag prune`"
    if ahead.short and (ahead.limit is not None or ahead.seconds < _LEAST_TIME):
        limit = "" if ahead.limit is None else f" ({ahead.limit / 1e9:.1f} GB)"
        advice = f"the disk is full before the recordings reach their bounds{limit}: free space, or lower --bag-bound"
        return "warn", text, advice
    return "ok", text


def _processor(_: Instance) -> Outcome:
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        return "warn", f"{cores} core", "real time needs two"
    files = Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    if slow := {file.read_text().strip() for file in files} - {"performance", "schedutil"}:
        advice = "`cpupower frequency-set -g performance` reduces jitter of the control loop"
        return "warn", f"{cores} cores, governor {', '.join(sorted(slow))}", advice
    own = [process.name for process in PROCESSES if process.cores == "own"]
    return "ok", f"{cores} cores; {' and '.join(own)} on core {own_core()} in simulation, the others on other cores"


def _real_time(_: Instance) -> Outcome:
    priority, niceness = max(row.real_time for row in PROCESSES), min(row.priority for row in PROCESSES)
    real_time, nice = granted(priority, niceness)
    if real_time:
        return "ok", f"control loops run with SCHED_FIFO, priority {priority}"
    instead = f"at nice {niceness} on hardware, at nice 0 in simulation" if nice else "at nice 0"
    advice = (
        f"/etc/security/limits.d/valor.conf: `{getpass.getuser()} - rtprio {priority}` and `… - nice {niceness}`, then "
        "log in again; in a container: --cap-add SYS_NICE"
    )
    return "warn", f"SCHED_FIFO is not granted: control loops run {instead}", advice


def _leftovers(_: Instance) -> Outcome:
    found = running.supervised_processes()
    groups = {(process.home, process.instance) for process in found}
    supervised = {(each.home, each.instance) for each in found if "supervisor.supervisord" in each.command}
    if orphaned := sorted(groups - supervised):
        text = ", ".join(f"instance {name} in {home}" for home, name in orphaned)
        advice = "; ".join(f"VALOR_HOME={home} valorctl down --instance {name}" for home, name in orphaned)
        return "fail", f"processes without a supervisor: {text}", advice
    there = "1 instance is" if len(groups) == 1 else f"{len(groups)} instances are"
    return "ok", f"none; {there} up on this computer"


def _link(instance: Instance) -> Outcome:
    """Check whether this computer's ends of the link receive from the other ends, by their own reports."""
    settings = instance.settings() if instance.settings_file.exists() else None
    here = settings.processes_here(settings.asked) if settings is not None else ()
    names = [name for name in NAMES if name in here]
    if settings is None or not names:
        return "ok", "no link"
    with Listener(instance, names) as listener:
        until = time.monotonic() + REPORT_TIMEOUT
        while len(listener.reports) < len(names) and time.monotonic() < until:
            listener.listen(0.1)
        found = {name: listener.reports.get(name) for name in names}
        now = time.monotonic()
    wrong = [
        f"{name}: {'runs, but does not report' if report is None else report.detail or report.state}"
        for name, report in found.items()
        if report is None or report.state != "ready" or now - report.received > REPORT_TIMEOUT
    ]
    if wrong:
        slow, fast = ports_to_robot(settings)
        advice = f"UDP, ports {slow} and {fast} of {settings.link.robot}, must reach the robot's end"
        return "warn", "; ".join(wrong), advice
    text = f"{' and '.join(names)}: connected"
    if behind(settings):
        text += f"; the operator's ROS domain is {settings.link.domain}"
    return "ok", text


def _sensors(instance: Instance) -> Outcome:
    """Check whether the sensors' topics arrive: on hardware of all in robot.yaml, in simulation of those requested."""
    if not instance.settings_file.exists():
        return "ok", f"{instance.name} is not up"
    settings = instance.settings()
    if robots_hosts(settings):
        return "ok", "on the robot's side of the link"
    simulated = settings.variant == "simulation"
    tables = RobotDescription.load(settings.robot).tables
    topics = [
        sensor.topic
        for name, sensor in SENSORS.items()
        if (sensor.process in settings.asked if simulated else getattr(tables, name) is not None)
    ]
    if not topics:
        return "ok", "none"
    from valor.valorctl.drive.arrivals import rates

    return arriving(rates(instance, topics), "valorctl logs" if simulated else "start its driver: docs/sensors.md")


def arriving(found: Mapping[str, float | None], advice: str) -> Outcome:
    """Result for topics by name with their rate, None without a publisher [Hz]."""
    text = ", ".join(
        f"{topic}: " + ("no publisher" if rate is None else f"{rate:.1f} Hz" if rate else "published, nothing arrives")
        for topic, rate in found.items()
    )
    return ("ok", text) if all(found.values()) else ("warn", text, advice)


CHECKS: dict[str, Callable[[Instance], Outcome]] = {
    "ros": _ros,
    "rendering": _rendering,
    "multicast": _multicast,
    "processor": _processor,
    "real time": _real_time,
    "disk": _disk,
    "instance": _supervisor,
    "keys": _keys,
    "ports": _ports,
    "link": _link,
    "leftovers": _leftovers,
    "sensors": _sensors,
}
