"""Checks of a robot's folder before anything starts, including the sections of the Whole-Body Controller."""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING

import msgspec

from valor.control.tuning_tables import margins_fit_the_soles
from valor.self_test.results import PROFILES, AcceptanceResult, Started

if TYPE_CHECKING:
    from valor.robot.checks.folder import Findings


def examine(folder: Path, control_rate: float | None = None) -> Findings:
    """Return all faults of a robot's folder; ``control_rate`` [Hz] replaces robot.yaml's."""
    from valor.robot.checks import folder as checks  # imports MuJoCo: 0.2 s
    from valor.robot.checks.controllers import controllers_exist

    return checks.examine(folder, control_rate, more=(margins_fit_the_soles, controllers_exist))


_POLL = 0.2  # [s]
_ONE_CORE = {"OPENBLAS_NUM_THREADS": "1", "MUJOCO_GL": "disable"}  # for each process


def run(
    folder: Path, check: Callable[[], None], tell: Callable[[str], None], policy: Path | None = None
) -> list[AcceptanceResult]:
    """Run all acceptance tests of a robot under all profiles, concurrently; returns the results by profile.

    ``check`` is called often and may raise, which ends the processes; ``tell``, with the name of the test that starts.
    ``policy``: run those of a policy's ONNX file instead.
    """
    arguments = [str(folder)] if policy is None else [str(folder), "--policy", str(policy)]
    lines: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
    results: dict[str, list[AcceptanceResult]] = {profile: [] for profile in PROFILES}
    last, running = dict.fromkeys(PROFILES, ""), len(PROFILES)
    with contextlib.ExitStack() as stack:
        children = {profile: stack.enter_context(_child([*arguments, profile])) for profile in PROFILES}
        for profile, child in children.items():
            threading.Thread(target=_read, args=(profile, child.stdout, lines), daemon=True).start()
        while running:
            check()
            try:
                profile, line = lines.get(timeout=_POLL)
            except queue.Empty:
                continue
            if not line:
                running -= 1
                if children[profile].wait() not in {0, 1} or not results[profile]:
                    reason = last[profile] or "no output"
                    results[profile].append(AcceptanceResult(profile, "play", passed=False, reason=reason))
                continue
            last[profile] = line.strip() or last[profile]
            with contextlib.suppress(msgspec.DecodeError):
                tell(f"{msgspec.json.decode(line, type=Started).begins} ({profile})")
            with contextlib.suppress(msgspec.DecodeError):
                results[profile].append(msgspec.json.decode(line, type=AcceptanceResult))
    return [result for each in results.values() for result in each]


def _read(profile: str, stream: IO[str], lines: queue.SimpleQueue[tuple[str, str]]) -> None:
    """Queue the lines, and an empty one at the end."""
    for line in stream:
        lines.put((profile, line))
    lines.put((profile, ""))


@contextlib.contextmanager
def _child(arguments: list[str]) -> Iterator[subprocess.Popen[str]]:
    """Run the self-test of one profile; its process ends with the context."""
    with subprocess.Popen(
        [sys.executable, "-m", "valor.self_test", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | _ONE_CORE,
    ) as child:
        try:
            yield child
        finally:
            child.kill()
