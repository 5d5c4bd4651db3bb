"""``doctor`` on all hosts: what each finds, and what holds between them."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import msgspec

import bifrost
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.resources import profile_file, robot_folder
from valor.valorctl.checks import Finding
from valor.valorctl.hosts import together
from valor.valorctl.hosts.channel import ANSWER, HELLO, HostError
from valor.valorctl.hosts.fleet import Fleet
from valor.valorctl.hosts.versions import known_as
from valor.valorctl.profile import Profile

LOOKING = 120.0  # [s]
APART = 0.1  # wall clocks that are to be told of [s]


def run_everywhere(instance: Instance, deployment: str | None, tell: Callable[[str], None]) -> list[Finding]:
    """What `doctor` finds on every host of a deployment, else of the instance that is up; first what is between them.

    Raises:
        ConfigurationError: no such deployment, or this computer has not joined it.
    """
    if deployment is None:
        settings = instance.settings()
    else:
        settings = together.settings_of(instance, deployment)
        found = together.deployed(instance, deployment)[0]
        robot = robot_folder(Profile.load(profile_file(found.profile)).defaults.robot)
        settings = msgspec.structs.replace(settings, robot=robot)
    settings = msgspec.structs.replace(settings, robot=Path(known_as(settings.robot)))
    with Fleet(instance, settings) as fleet:
        tell("all hosts: versions")
        between = [_versions(fleet, lambda: together.require_same(fleet, settings))]
        tell("all hosts: clocks")
        between += [*_clocks(instance), _wall_clocks(fleet, settings.here)]
        tell("all hosts: each looks at itself")
        answers = fleet.ask("findings", LOOKING)
        findings = [*between]
        for name, answer in answers.items():
            if isinstance(answer, HostError):
                advice = f"start its agent there: valorctl host agent {settings.deployment}"
                findings.append(Finding("host", "fail", fleet.told(name, answer), advice, name))
            else:
                findings += [Finding(**row | {"host": name}) for row in answer]
    return findings


def _clocks(instance: Instance) -> list[Finding]:
    """What this host's bifrostd has measured of the others' clocks since boot, by which messages are stamped."""
    if not instance.network_file.exists():
        return []
    info = bifrost.daemon_alive(bifrost.Network.load(instance.network_file, instance.keys), timeout=ANSWER)
    if info is None or not info.clocks:
        return [Finding("clocks", "warn", "not measured yet: no other host's bifrostd has answered")]
    told = []
    for name, (ahead, error, drift) in info.clocks.items():
        gains = "" if drift is None else f", gains {1e6 * drift:+.1f} ppm"
        told.append(f"{name} is {ahead:+.4f} s ahead, to {1e3 * error:.1f} ms{gains}")
    return [Finding("clocks", "ok", f"since boot, by which Bifrost stamps: {'; '.join(told)}")]


def _wall_clocks(fleet: Fleet, here: str) -> Finding:
    """How far the others' wall clocks are from this host's: ROS 2 on hardware stamps by them, and logs."""
    told, apart = [], 0.0
    for name in fleet.switchboard.names:
        sent = time.time()
        answer = fleet.switchboard.ask(HELLO, {name: {}})[name]
        back = time.time()
        if name == here or isinstance(answer, HostError):
            continue
        ahead, error = answer - 0.5 * (sent + back), 0.5 * (back - sent)
        apart = max(apart, abs(ahead) - error)
        told.append(f"{name} is {ahead:+.3f} s ahead, to {1e3 * error:.0f} ms")
    text = "; ".join(told) or "no other host answers"
    if apart > APART:
        return Finding("wall clock", "warn", text, "chrony or PTP on every host: ROS 2 on hardware, and logs, go by it")
    return Finding("wall clock", "ok", text)


def _versions(fleet: Fleet, require_same: Callable[[], None]) -> Finding:
    try:
        require_same()
    except ValorError as error:
        advice = "install the same valor on all hosts, and the same robot"
        return Finding("versions", "fail", "; ".join(str(error).splitlines()), advice)
    return Finding("versions", "ok", f"the same code and robot on {', '.join(fleet.switchboard.names)}")
