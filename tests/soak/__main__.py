"""``make soak``: random activities and events, or given pairs of them; see ``--help``."""

from __future__ import annotations

import argparse
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

from tests.soak.activities import ACTIVITIES
from tests.soak.rig import BrokenError, Rig
from tests.soak.run import Outcome, Soak
from valor.common.errors import ValorError


def main() -> int:
    arguments = _arguments()
    for number in (signal.SIGINT, signal.SIGTERM):  # in the background the first would be ignored
        signal.signal(number, signal.default_int_handler)
    home = Path(tempfile.mkdtemp(prefix="soak-"))
    rig = Rig(home, arguments.profile, "--seed", str(arguments.seed))
    failed = _soak(rig, arguments)
    if failed:
        print(f"logs and bags stay in {home}")
    else:
        shutil.rmtree(home)
    return 1 if failed else 0


def _soak(rig: Rig, arguments: argparse.Namespace) -> bool:
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
        for number in (signal.SIGINT, signal.SIGTERM):  # a second interrupt would leave a system running
            signal.signal(number, signal.SIG_IGN)
        rest += soak.close()
    return _report(done, rest, arguments)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--steps", type=int, help="number of steps, regardless of the time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="first step, to repeat one")
    parser.add_argument("--profile", default="sim")
    parser.add_argument("--rows", nargs="+", metavar="ACTIVITY/EVENT", help="only these, --times each")
    parser.add_argument("--times", type=int, default=5)
    return parser.parse_args()


def _plan(arguments: argparse.Namespace, soak: Soak, began: float) -> Iterator[tuple[str, str, random.Random]]:
    if arguments.rows:
        for time_ in range(arguments.times):
            for row in arguments.rows:
                activity, event = row.split("/", 1)
                yield activity, event, random.Random(f"{arguments.seed}/{row}/{time_}")
        return
    number = arguments.first
    while (
        number - arguments.first < arguments.steps
        if arguments.steps
        else time.monotonic() - began < 60.0 * arguments.minutes
    ):
        rng = random.Random(f"{arguments.seed}/{number}")
        yield *soak.choose(rng), rng
        number += 1


def _table(done: list[Outcome]) -> Iterator[str]:
    """Markdown as in docs/reliability.md: where each event left the robot, by activity."""
    happened: dict[str, list[Outcome]] = defaultdict(list)
    for each in done:
        if each.before:
            happened[each.event].append(each)
    yield "| event | behavior afterwards: activities | times | ready after [s] |"
    yield "|---|---|---|---|"
    for event, outcomes in sorted(happened.items()):
        ends: dict[str, set[str]] = defaultdict(set)
        for each in outcomes:
            same = each.after == each.before
            ends["unchanged" if same else each.after or "not ready within 60 s"].add(each.activity)
        after = "; ".join(f"{end}: {', '.join(name for name in ACTIVITIES if name in ends[end])}" for end in ends)
        ready = max((each.ready for each in outcomes if each.ready == each.ready), default=float("nan"))
        yield f"| {event} | {after} | {len(outcomes)} | {ready:.1f} |"
    still = [each.moved for each in done if ACTIVITIES[each.activity].held and each.moved == each.moved]
    yield f"\nLargest movement of a joint that was to stay: {max(still, default=float('nan')):.2f} rad."


def _report(done: list[Outcome], rest: list[str], arguments: argparse.Namespace) -> bool:
    print("", *_table(done), sep="\n")
    failed = [(number, each) for number, each in enumerate(done, arguments.first) if each.failures]
    for number, each in failed:
        print(f"step {number} of seed {arguments.seed}, {arguments.profile}: {each.line()}")
        if not arguments.rows:
            print(f"  again: make soak SEED={arguments.seed} PROFILE={arguments.profile} FIRST={number} STEPS=1")
    for trouble in rest:
        print(f"at the end: {trouble}")
    print(f"{len(done)} steps, {len(failed)} failed, load {os.getloadavg()[0]:.1f}")
    return bool(failed or rest)


if __name__ == "__main__":
    sys.exit(main())
