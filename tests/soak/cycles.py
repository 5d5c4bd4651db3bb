"""Nothing but up and down: how long each takes, and what is left behind, once or growing."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields
from statistics import median

from tests.soak.checks import in_logs
from tests.soak.rig import Rig


@dataclass(frozen=True)
class Cycle:
    """One up and down.

    Attributes:
        up, down: how long they took [s].
        left: processes, sockets, keys and shared memory that are still there.
        files: of the instance, without its recordings and logs.
        logs: of the instance [KiB].
    """

    up: float
    down: float
    left: int
    files: int
    logs: float


def _kept(rig: Rig) -> tuple[int, float]:
    """How many files the instance has kept, and how large its logs are [KiB]."""
    instance = rig.instance
    here = [each for each in instance.logs.parent.rglob("*") if each.is_file()]
    logs = sum(each.stat().st_size for each in here if instance.logs in each.parents)
    return sum(not {instance.logs, instance.bags} & set(each.parents) for each in here), logs / 1024


def cycle(rig: Rig, count: int) -> list[str]:
    """So many, each a line; returns what was left, or grew."""
    found: list[str] = []
    done: list[Cycle] = []
    print(*(f"{field.name:>8}" for field in fields(Cycle)))
    for _ in range(count):
        began = time.monotonic()
        rig.up()
        up = time.monotonic()
        left = rig.down()
        found += left
        done.append(Cycle(up - began, time.monotonic() - up, len(left), *_kept(rig)))
        print(*(f"{value:8.1f}" for value in vars(done[-1]).values()), flush=True)
    found += in_logs(rig.instance.logs)
    if done[-1].files > done[0].files:
        found.append(f"{done[-1].files - done[0].files} files more after {count} cycles than after one")
    for verb in ("up", "down"):
        taken = [getattr(each, verb) for each in done]
        print(f"{verb}: median {median(taken):.1f} s, worst {max(taken):.1f} s of {count}")
    return found
