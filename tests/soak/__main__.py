"""``make soak``: hours of it, or the rows of docs/reliability.md; see ``--help``."""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from tests.soak.activities import ACTIVITIES
from tests.soak.checks import in_logs
from tests.soak.rig import BrokenError, Rig
from tests.soak.rows import everything
from tests.soak.run import Outcome, Soak
from valor.common.errors import ValorError


def main() -> int:
    """Returns the exit status: 0 where everything held."""
    arguments = _arguments()
    home = Path(tempfile.mkdtemp(prefix="soak-"))
    rig = Rig(home, arguments.profile, "--robot", arguments.robot, "--seed", str(arguments.seed))
    if arguments.cycles:
        return _cycle(rig, arguments.cycles)
    done: list[Outcome] = []
    rest: list[str] = []
    began = time.monotonic()
    soak = Soak(rig)
    try:
        for number, (activity, event, rng) in enumerate(_plan(arguments, soak, began), arguments.first):
            outcome = soak.step(activity, event, rng)
            done.append(outcome)
            print(f"{time.monotonic() - began:6.0f} s  step {number}  {outcome.line()}", flush=True)
    except KeyboardInterrupt:
        print("interrupted")
    except (AssertionError, ValorError, BrokenError, subprocess.TimeoutExpired) as error:
        rest.append(f"cannot go on: {error}")
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever is impatient would leave a system behind
        rest += soak.close()
    if arguments.out:
        _write(arguments.out, arguments.profile, done)
    failed = _report(done, rest, arguments)
    if failed:
        print(f"logs and bags stay in {home}")
    else:
        shutil.rmtree(home)
    return 1 if failed else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--steps", type=int, help="so many, however long they take")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="the step to begin with: to see one again")
    parser.add_argument("--profile", default="sim")
    parser.add_argument("--robot", default="escher")
    parser.add_argument("--rows", nargs="*", metavar="ACTIVITY/EVENT", help="these alone, each --times; none: all")
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--cycles", type=int, default=0, help="nothing but so many times up and down")
    parser.add_argument("--out", type=Path, help="add what was measured to this file")
    return parser.parse_args()


def _plan(arguments: argparse.Namespace, soak: Soak, began: float) -> Iterator[tuple[str, str, random.Random]]:
    if arguments.rows is not None:
        for row in arguments.rows or everything(soak.events, ACTIVITIES):
            for time_ in range(arguments.times):
                activity, event = row.split("/")
                yield activity, event, random.Random(f"{arguments.seed}/{row}/{time_}")
        return
    number = arguments.first
    while (number - arguments.first < arguments.steps) if arguments.steps else (
        time.monotonic() - began < 60.0 * arguments.minutes
    ):  # fmt: skip
        rng = random.Random(f"{arguments.seed}/{number}")
        yield *soak.choose(rng), rng
        number += 1


def _cycle(rig: Rig, cycles: int) -> int:
    """Up and down; returns 1 where something was left, once or growing."""
    found: list[str] = []
    times: list[tuple[float, float]] = []
    for _ in range(cycles):
        began = time.monotonic()
        rig.up()
        up = time.monotonic()
        found += rig.down()
        times.append((up - began, time.monotonic() - up))
        print(f"up {times[-1][0]:.1f} s, down {times[-1][1]:.1f} s", flush=True)
    found += in_logs(rig.instance.logs)
    for verb, column in (("up", 0), ("down", 1)):
        taken = [each[column] for each in times]
        print(f"{verb}: median {median(taken):.1f} s, worst {max(taken):.1f} s of {cycles}")
    print(*found, sep="\n")
    shutil.rmtree(rig.home)
    return bool(found)


def _write(file: Path, profile: str, done: list[Outcome]) -> None:
    rows = json.loads(file.read_text()) if file.exists() else []
    rows += [vars(each) | {"profile": profile} for each in done]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(rows, indent=1))


def _report(done: list[Outcome], rest: list[str], arguments: argparse.Namespace) -> bool:
    rows: dict[str, list[Outcome]] = defaultdict(list)
    for each in done:
        rows[each.event].append(each)
    print(f"\n{'event':32} times failed  ready after [s]: median  worst")
    for event, outcomes in sorted(rows.items()):
        ready = sorted(each.ready for each in outcomes if each.ready == each.ready)
        times = f"{median(ready):22.2f} {ready[-1]:6.2f}" if ready else ""
        print(f"{event:32} {len(outcomes):5} {sum(bool(each.failures) for each in outcomes):6}  {times}")
    failed = [(number, each) for number, each in enumerate(done, arguments.first) if each.failures]
    for number, each in failed:
        print(f"step {number} of seed {arguments.seed}, {arguments.profile}: {each.line()}")
        if arguments.rows is None:
            print(f"  again: make soak SEED={arguments.seed} PROFILE={arguments.profile} FIRST={number} STEPS=1")
    for trouble in rest:
        print(f"at the end: {trouble}")
    print(f"{len(done)} steps, {len(failed)} failed, load {os.getloadavg()[0]:.1f}")
    return bool(failed or rest)


if __name__ == "__main__":
    sys.exit(main())
