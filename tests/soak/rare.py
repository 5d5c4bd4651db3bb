"""Rarer events: two processes at once, while coming up, without memory, room, links, or a device."""

from __future__ import annotations

import contextlib
import random
import signal
import time
from collections.abc import Sequence
from functools import partial

import psutil

import bifrost
from tests.soak import disk, links
from tests.soak.event import Event
from tests.soak.rig import BrokenError, Rig
from valor.common import membership
from valor.common.errors import ValorError
from valor.common.messages import FaultRequest
from valor.common.topics import FAULT, VALORCTL

CAPPED = 5.0  # without another page of memory [s]
FULL = 3.0  # that a disk stays full once its recorder has told [s]
UNPLUGGED = 1.5  # [s]
PAIRS = (
    ("motion_manager", "comms_manager"),
    ("motion_manager", "valor_ros_controller"),
    ("motion_manager", "bifrostd"),
    ("bifrostd", "bag_recorder"),
)
UNITS = ("legs/1", "imu", "hdt/left_arm", "force_torque/1")
_NEEDED = ("motion_manager", "comms_manager", "valor_ros_controller", "bag_recorder")


def _kill_both(rig: Rig, rng: random.Random, process: str, other: str) -> list[str]:
    """Within a millisecond, in any order."""
    for name in rng.sample((process, other), 2):
        rig.send(name, signal.SIGKILL)
    return []


def _kill_while_up(rig: Rig, rng: random.Random, process: str) -> list[str]:
    """As soon as it runs, or up to three seconds later."""
    found = rig.down()
    up = rig.begin_up()

    def begun() -> bool:
        with contextlib.suppress(ValorError):  # there is no supervisor yet
            return process in rig.pids() or up.poll() is not None
        return up.poll() is not None

    rig.wait(begun, f"{process} begun by `up`")
    time.sleep(rng.uniform(0.0, 3.0))
    with contextlib.suppress(ValorError, BrokenError):  # `up` has given up by itself
        rig.send(process, signal.SIGKILL)
    return found + rig.end_up(up, process)


def _cap(rig: Rig, rng: random.Random, process: str) -> list[str]:
    """What it has is all that it gets: it may go on, or end and be begun anew."""
    rig.excused.add(process)
    capped = psutil.Process(rig.pids()[process])
    before = capped.rlimit(psutil.RLIMIT_AS)
    try:
        capped.rlimit(psutil.RLIMIT_AS, (capped.memory_info().rss, before[1]))
        time.sleep(CAPPED)
        capped.rlimit(psutil.RLIMIT_AS, before)
    except psutil.NoSuchProcess:
        pass  # it could not go on
    return []


def _cut(rig: Rig, rng: random.Random, process: str) -> list[str]:
    """Each of its connections, three times in a second."""
    for _ in range(3):
        if not links.cut(rig.pids()[process]):
            return [f"{process} has no connections"]
        time.sleep(rng.uniform(0.1, 0.5))
    return []


def _fill_disk(rig: Rig, rng: random.Random, process: str) -> list[str]:
    """Until its recorder says so, and a while longer."""
    disk.fill(rig.home)
    try:
        rig.wait(lambda: rig.tap.words[process].state == "degraded", "the recorder's word that it does not record")
        time.sleep(FULL)
    finally:
        disk.empty(rig.home)
    return []


def _unplug(rig: Rig, rng: random.Random, unit: str) -> list[str]:
    """A device, and plug it in again."""
    device, _, name = unit.partition("/")
    with bifrost.Node("soak_bench", network=membership.network(rig.instance, VALORCTL)) as node:
        fault = FAULT.client(node)
        fault.wait_for_server(5.0)
        reply = fault.call(FaultRequest(device, name or device, "unplugged", UNPLUGGED), timeout=5.0)
    if not reply.accepted:
        return [f"fault refused: {reply.reason}"]
    time.sleep(UNPLUGGED)
    return []


def rare_events(processes: Sequence[str], own_disk: bool) -> dict[str, Event]:
    """The table, for a profile's processes; a disk is filled only if it is nobody else's."""
    table = {
        f"kill {first} and {second}": Event(partial(_kill_both, other=second), 0.3, "kill", process=first, other=second)
        for first, second in PAIRS
    }
    for name in processes:
        table[f"kill {name} during up"] = Event(_kill_while_up, 0.1, "up", name, idle=True)
    for name in _NEEDED:
        table[f"links of {name} cut"] = Event(_cut, 0.5, "cut", name)
        table[f"memory of {name} capped"] = Event(_cap, 0.2, "cap", name)
    if own_disk:
        table["full disk"] = Event(_fill_disk, 0.3, "disk", "bag_recorder")
    if "device_emulators" in processes:
        for unit in UNITS:
            table[f"unplug {unit}"] = Event(_unplug, 0.5, "unplug", unit)
    return table
