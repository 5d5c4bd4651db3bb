"""Cables of a robot's hosts pulled and put back, hosts without power, ssh servers killed: what happens, what is obeyed.

Three network namespaces stand for the hosts. Before the fault the robot is brought to a behavior; while it lasts an
operator's ROS 2 program goes on sending: commands of one kind, the last at least 1.5 s before the fault ends (with
shorter ones: once, at its beginning). What of them the Motion Manager obeys afterwards, it obeys late; what is 0.2 s
old is in time.

    cable   the host's cable is out
    power   its cable is out, all of its processes are killed; then ``valorctl host resume`` starts them again
    ssh     only its ssh server is killed, and started again

It ends with a table, a row a fault: the behavior when the fault ends and in the end, whether the robot stayed on its
feet, how long until every process is ready, what was sent, whether any of it was obeyed late, what became of it for
the client if it was an action's goal, how far the pelvis moved, and whether the operator is obeyed again. After a row
that is not as it should be the robot is started anew. Exit status 0: all are as they should be.

With ``--into FILE`` each row is appended there, and those that it has are not measured again: so the matrix can be had
in pieces.

    .venv/bin/python -m benchmarks.cables [--faults cable power ssh] [--seconds 0.2 2 20]
        [--hosts motion perception operator] [--behaviors …] [--into FILE] [--at-most 10]
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import msgspec
from rich.console import Console

from benchmarks.cable_cases import CASES, Case
from benchmarks.tables import Columns, table
from harness.computers import ComputersError
from harness.hosts import Hosts, deployment_text, hosts

INSTANCE = "cables"
NAMES = ("motion", "perception", "operator")
FAULTS = ("cable", "power", "ssh")
HEALED = 90.0  # [s]
STALE = 1.5  # at the least, of what is sent while the fault lasts, once it is over [s]
AFTER = 3.0  # looked at behind everything being ready [s]
PERIOD = 0.1  # between velocities [s]
LOW = 0.25  # of a pelvis that has sunk: the robot is not on its feet [m]
LEAN = 0.7  # cosine of an upright pelvis' lean
BEGUN = 30.0  # what the robot is asked to do [s]
LIMIT = 300.0  # of one fault, besides its length [s]


class Row(msgspec.Struct):
    """What became of one fault."""

    fault: str
    host: str
    case: str
    seconds: float
    during: str = ""  # behavior when it was over
    end: str = ""  # and in the end
    fell: bool = True
    ready: float = HEALED  # after it was over [s]
    sent: int = 0
    arrived: int = 0  # signs at the Motion Manager of what was sent, behind its end
    refused: int = 0
    known: str = ""  # what the client knows of its goal in the end
    moved: float = 0.0  # of the pelvis, from the fault's end on [m]
    again: str = ""  # whether the operator is obeyed in the end
    load: float = 0.0

    @property
    def key(self) -> tuple[str, str, str, float]:
        """Which fault this was."""
        return self.fault, self.host, self.case, self.seconds

    @property
    def late(self) -> str:
        """Effect of the commands sent while the fault lasted: "no", "in time" or "yes", with counts."""
        if self.arrived <= self.refused:
            return "no"
        in_time = self.seconds < STALE or self.fault == "ssh"  # which nothing waits for
        return "in time" if in_time else f"yes ({self.arrived}, {self.refused} refused)"

    @property
    def good(self) -> bool:
        """As it should be."""
        return not self.fell and self.ready < HEALED and self.again == "yes" and not self.late.startswith("yes")


COLUMNS: Columns[Row] = (
    ("fault", lambda row: row.fault),
    ("host", lambda row: row.host),
    ("behavior", lambda row: row.case),
    ("[s]", lambda row: f"{row.seconds:g}"),
    ("then", lambda row: row.during),
    ("in the end", lambda row: row.end),
    ("safe", lambda row: "no" if row.fell else "yes"),
    ("ready [s]", lambda row: f"{row.ready:.1f}"),
    ("sent", lambda row: str(row.sent)),
    ("obeyed late", lambda row: row.late),
    ("the client knows", lambda row: row.known),
    ("moved [mm]", lambda row: f"{1e3 * row.moved:.0f}"),
    ("obeys", lambda row: row.again),
    ("load", lambda row: f"{row.load:.0f}"),
)


class Bench:
    """The hosts, a tap on motion's, an operator's program on the operator's."""

    def __init__(self, computers: Hosts) -> None:
        self._hosts = computers
        self._file = computers.folder / "tap.jsonl"
        self._file.touch()
        self._tap = self._run("motion", "tap", str(self._file))
        self._operator = self._run("operator", "operate")
        assert self._operator.stdout is not None
        self._operator.stdout.readline()
        while self._say("known") != "True":
            time.sleep(0.2)

    def close(self) -> None:
        """End both."""
        for process in (self._tap, self._operator):
            process.kill()  # they hold nothing
            process.wait()

    def _run(self, host: str, role: str, *more: str) -> subprocess.Popen[str]:
        home = self._hosts.home(host)
        return subprocess.Popen(
            self._hosts.command(host, sys.executable, "-m", "benchmarks.cable_ends", role, str(home), INSTANCE, *more),
            env=self._hosts.environment(host) | {"PYTHONPATH": str(Path(__file__).parents[1])},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def _say(self, line: str) -> str:
        assert self._operator.stdin is not None and self._operator.stdout is not None
        self._operator.stdin.write(line + "\n")
        self._operator.stdin.flush()
        return self._operator.stdout.readline().strip()

    def _events(self, since: float) -> list[dict[str, Any]]:
        with open(self._file, encoding="utf-8") as file:
            found = [json.loads(line) for line in file if line.endswith("\n")]
        return [each for each in found if each["at"] >= since]

    def _states(self, since: float) -> list[dict[str, Any]]:
        """At least one: waits for it."""
        while not (found := [each for each in self._events(since) if each["kind"] == "state"]):
            time.sleep(PERIOD)
        return found

    def _mode(self, *modes: str) -> str:
        for mode in modes:
            done = subprocess.run(
                self._hosts.command("operator", str(Path(sys.executable).with_name("valorctl")), "mode", mode),
                env=self._hosts.environment("operator"),
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode:
                return (done.stdout + done.stderr).strip().splitlines()[-1][:80]
        return "yes"

    def _stand(self) -> str:
        """From wherever the robot is; why not, else "yes"."""
        now = self._states(time.time())[-1]["behavior"]
        stopped = now in ("freeze", "stand_prep", "soft_stop", "idle")
        return self._mode(*(("stand_prep", "stand") if stopped else ("stand",)))

    def _keep(self, line: str, seconds: float, repeated: bool) -> int:
        """Send a line, or again and again for so long; how often."""
        count, end = 0, time.monotonic() + seconds
        while not count or (repeated and time.monotonic() < end):
            self._say(line)
            count += 1
            time.sleep(PERIOD)
        time.sleep(max(0.0, end - time.monotonic()))
        return count

    def _do(self, case: Case) -> None:
        """Bring the robot to do what it is to do, asked again and again as a person would."""
        asked = time.time()
        while case.begin:
            self._keep(case.begin, 3.0, case.repeated)
            if case.begun is None or any(map(case.begun, self._events(asked))):
                return
            if time.time() - asked > BEGUN:
                raise ValueError(f"{case.begin}: not obeyed within {BEGUN:g} s")

    def _begin(self, fault: str, host: str) -> None:
        if fault != "ssh":
            self._hosts.network.pull(host)  # nobody hears of it: without power nothing is closed
        if fault == "power":
            self._hosts.cut_power(host)
        if fault == "ssh":
            self._hosts.kill_ssh(host)

    def _end(self, fault: str, host: str) -> None:
        self._hosts.network.plug(host)
        if fault == "power":
            self._hosts.restore_power(host)
        if fault == "ssh":
            self._hosts.start_ssh(host)

    def suffer(self, fault: str, host: str, case: Case, seconds: float) -> Row:
        """One fault.

        Raises:
            ValueError: the robot did not come to the behavior.
        """
        row = Row(fault, host, case.name, seconds)
        if (said := self._mode(case.mode)) != "yes":
            raise ValueError(f"mode {case.mode}: {said}")
        self._do(case)
        first = self._states(time.time())[-1]
        if first["behavior"] != case.mode:
            raise ValueError(f"behavior {first['behavior']}; expected {case.mode}")
        self._begin(fault, host)
        began, pulled = time.monotonic(), time.time()
        row.sent = self._keep(case.late, max(0.0, seconds - STALE), case.repeated)
        time.sleep(max(0.0, seconds - (time.monotonic() - began)))
        last = [first, *(each for each in self._events(pulled) if each["kind"] == "state")][-1]
        row.during, plugged = last["behavior"], time.time()
        self._end(fault, host)
        while not self._hosts.status("operator")["ready"] and time.time() - plugged < HEALED:
            time.sleep(0.2)
        row.ready = time.time() - plugged
        time.sleep(AFTER)
        events, states = self._events(plugged), self._states(plugged)
        rejections = [each for each in events if each["kind"] == "rejection"]
        row.arrived = sum(map(case.obeyed, events))
        row.refused = sum(each["value"] == case.topic for each in rejections)
        row.moved = max(math.dist(each["place"][:2], last["place"][:2]) for each in states)
        row.end, row.known = states[-1]["behavior"], self._say("ends") if case.late.startswith("goal") else ""
        row.again = self._stand()
        row.fell = any(
            each["place"][2] < first["place"][2] - LOW or each["upright"] < LEAN for each in self._states(pulled)
        )
        row.load = os.getloadavg()[0]
        return row


@contextmanager
def _within(seconds: float) -> Iterator[None]:
    """Raises TimeoutError in what takes longer."""

    def late(_signum: int, _frame: object) -> NoReturn:
        raise TimeoutError(f"not over within {seconds:g} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def _bench() -> Iterator[Bench]:
    """A robot on three hosts."""
    text = deployment_text("drc")
    with (
        tempfile.TemporaryDirectory(prefix="vh-", ignore_cleanup_errors=True) as folder,
        hosts(Path(folder), text, INSTANCE, *NAMES, perception=3.0, operator=-2.0) as made,
    ):
        made.valorctl("operator", "up", "--deployment", str(made.file))
        with _within(LIMIT):
            bench = Bench(made)
        try:
            yield bench
        finally:
            bench.close()


def _measured(wanted: list[tuple[str, str, Case, float]]) -> Iterator[Row]:
    """Rows, one after the other; with another robot behind one that is not as it should be."""
    while wanted:
        with _bench() as bench:
            good = True
            while wanted and good:
                fault, host, case, seconds = wanted.pop(0)
                try:
                    with _within(LIMIT + seconds):
                        row = bench.suffer(fault, host, case, seconds)
                except Exception as error:  # it is what there is to be told of this fault
                    said = f"{type(error).__name__}: {error}".splitlines()[0]
                    row = Row(fault, host, case.name, seconds, again=said, load=os.getloadavg()[0])
                good = row.good
                print(row, flush=True)
                yield row


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=["cable"])
    parser.add_argument("--seconds", type=float, nargs="+", default=[0.2, 2.0, 20.0])
    parser.add_argument("--hosts", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--behaviors", nargs="+", choices=[case.name for case in CASES])
    parser.add_argument(
        "--into", type=Path, metavar="FILE", help="JSON, a line a row; those that it has are not measured"
    )
    parser.add_argument("--at-most", type=int, metavar="N", help="rows now")
    return parser.parse_args()


def main() -> None:
    """Print the table."""
    options = _options()
    rows: list[Row] = []
    if options.into is not None and options.into.exists():
        rows = [msgspec.json.decode(line, type=Row) for line in options.into.read_bytes().splitlines()]
    known = {row.key for row in rows}
    cases = [case for case in CASES if not options.behaviors or case.name in options.behaviors]
    wanted = [
        (fault, host, case, seconds)
        for fault, seconds, host, case in itertools.product(options.faults, options.seconds, options.hosts, cases)
        if (fault, host, case.name, seconds) not in known
    ][: options.at_most]
    try:
        for row in _measured(wanted):
            rows.append(row)
            if options.into is not None:
                with open(options.into, "ab") as file:
                    file.write(msgspec.json.encode(row) + b"\n")
    except ComputersError as error:
        sys.exit(str(error))
    finally:
        if rows:
            title = f"Hosts' faults, load {os.getloadavg()[0]:.1f}"
            Console(width=190).print(table(title, COLUMNS, rows, left=["fault", "host", "behavior"]))
    sys.exit(not all(row.good for row in rows))


if __name__ == "__main__":
    main()
