"""``make soak``: hours of it, or the rows of docs/reliability.md; see ``--help``."""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from tests.soak import disk, rows
from tests.soak.cycles import cycle
from tests.soak.rig import BrokenError, Rig
from tests.soak.run import Outcome, Soak
from valor.common.errors import ValorError


def main() -> int:
    """Returns the exit status: 0 where everything held."""
    arguments = _arguments()
    for number in (signal.SIGINT, signal.SIGTERM):  # in the background the first would be ignored
        signal.signal(number, signal.default_int_handler)
    home = Path(tempfile.mkdtemp(prefix="soak-"))
    failed = True
    try:
        rig = Rig(home, arguments.profile, "--robot", arguments.robot, "--seed", str(arguments.seed))
        if not rig.own_disk:
            print("skipped: full disk (this user may not mount one in memory)")
        failed = _cycle(rig, arguments.cycles) if arguments.cycles else _soak(rig, arguments)
    finally:
        if kept := disk.leave(home, keep=failed):
            print(f"logs and bags stay in {kept}")
    return 1 if failed else 0


def _cycle(rig: Rig, count: int) -> bool:
    found = cycle(rig, count)
    print(*found, sep="\n")
    return bool(found)


def _soak(rig: Rig, arguments: argparse.Namespace) -> bool:
    done: list[Outcome] = []
    rest: list[str] = []
    began = time.monotonic()
    soak = Soak(rig)
    try:
        for number, (activity, event, rng) in enumerate(_plan(arguments, soak, began), arguments.first):
            outcome = soak.step(activity, event, rng)
            done.append(outcome)
            if arguments.out:
                rows.add(arguments.out, arguments.profile, outcome)
            print(f"{time.monotonic() - began:6.0f} s  step {number}  {outcome.line()}", flush=True)
    except KeyboardInterrupt:
        print("interrupted")
    except (AssertionError, ValorError, BrokenError, subprocess.TimeoutExpired) as error:
        rest.append(f"cannot go on: {error}")
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):  # whoever is impatient would leave a system behind
            signal.signal(number, signal.SIG_IGN)
        rest += soak.close()
    return _report(done, rest, arguments)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--steps", type=int, help="so many, however long they take")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="the step to begin with: to see one again")
    parser.add_argument("--profile", default="sim")
    parser.add_argument("--robot", default="escher")
    parser.add_argument(
        "--rows", nargs="*", metavar="ACTIVITY/EVENT", help="these alone, each --times in all; none: all"
    )
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--cycles", type=int, default=0, help="nothing but so many times up and down")
    parser.add_argument("--out", type=Path, help="add each step's outcome to this file, a line each")
    return parser.parse_args()


def _plan(arguments: argparse.Namespace, soak: Soak, began: float) -> Iterator[tuple[str, str, random.Random]]:
    def late() -> bool:
        return bool(time.monotonic() - began > 60.0 * arguments.minutes)

    if arguments.rows is not None:
        wanted = arguments.rows or rows.everything(soak.events)
        for row, time_ in rows.to_do(arguments.out, arguments.profile, wanted, arguments.times):
            if late():
                return
            activity, event = row.split("/", 1)
            yield activity, event, random.Random(f"{arguments.seed}/{row}/{time_}")
        return
    number = arguments.first
    while number - arguments.first < arguments.steps if arguments.steps else not late():
        rng = random.Random(f"{arguments.seed}/{number}")
        yield *soak.choose(rng), rng
        number += 1


def _report(done: list[Outcome], rest: list[str], arguments: argparse.Namespace) -> bool:
    happened: dict[str, list[Outcome]] = defaultdict(list)
    for each in done:
        happened[each.event].append(each)
    print(f"\n{'event':32} times failed  ready after [s]: median  worst")
    for event, outcomes in sorted(happened.items()):
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
