"""A robot played in one process, an actuator profile a process: ``valor.rehearsal`` is asked, its lines are read."""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import msgspec

PROFILES = ("ideal", "hardware")
_POLL = 0.2  # [s]
_ALONE = {"OPENBLAS_NUM_THREADS": "1", "MUJOCO_GL": "disable"}  # both processes have their core


class Numbers(msgspec.Struct):
    """What was seen of a rung; see ``valor.rehearsal.watch``."""

    tilt: float  # [rad]
    dcm_error: float | None  # [m]
    distance: float  # [m]
    knee_margin: float | None  # [rad]
    at_limit: dict[str, float]  # joint → share of the time
    unsolved: int  # periods


class Rung(msgspec.Struct):
    """How a rung went, under an actuator profile."""

    profile: str
    name: str
    passed: bool
    reason: str = ""
    told: str = ""
    numbers: Numbers | None = None


class _Begins(msgspec.Struct):
    profile: str
    begins: str


def play(folder: Path, check: Callable[[], None], tell: Callable[[str], None]) -> list[Rung]:
    """Play all rungs under both profiles, side by side.

    Args:
        folder: of a robot that is sound.
        check: called often; may raise, and the processes are ended.
        tell: what is being played.

    Returns:
        The rungs, profile by profile.
    """
    with contextlib.ExitStack() as stack:
        children = {profile: stack.enter_context(_child(folder, profile)) for profile in PROFILES}
        lines: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
        for profile, child in children.items():
            assert child.stdout is not None
            threading.Thread(target=_read, args=(profile, child.stdout, lines), daemon=True).start()
        return _collected(children, lines, check, tell)


def _collected(
    children: dict[str, subprocess.Popen[str]],
    lines: queue.SimpleQueue[tuple[str, str]],
    check: Callable[[], None],
    tell: Callable[[str], None],
) -> list[Rung]:
    rungs: dict[str, list[Rung]] = {profile: [] for profile in children}
    last, ended = dict.fromkeys(children, ""), 0
    while ended < len(children):
        check()
        try:
            profile, line = lines.get(timeout=_POLL)
        except queue.Empty:
            continue
        if not line:
            ended += 1
            if children[profile].wait() not in {0, 1} or not rungs[profile]:
                rungs[profile].append(Rung(profile, "play", passed=False, reason=last[profile] or "ended at once"))
            continue
        last[profile] = line.strip() or last[profile]
        with contextlib.suppress(msgspec.DecodeError):
            tell(f"{msgspec.json.decode(line, type=_Begins).begins} ({profile})")
        with contextlib.suppress(msgspec.DecodeError):
            rungs[profile].append(msgspec.json.decode(line, type=Rung))
    return [rung for each in rungs.values() for rung in each]


def _read(profile: str, stream: IO[str], lines: queue.SimpleQueue[tuple[str, str]]) -> None:
    """Hand on lines; an empty one at the end."""
    for line in stream:
        lines.put((profile, line))
    lines.put((profile, ""))


@contextlib.contextmanager
def _child(folder: Path, profile: str) -> Iterator[subprocess.Popen[str]]:
    """A process that plays one profile; it does not outlive us."""
    command = [sys.executable, "-m", "valor.rehearsal", str(folder), profile]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env=os.environ | _ALONE,
    ) as child:  # fmt: skip
        try:
            yield child
        finally:
            if child.poll() is None:
                child.kill()
