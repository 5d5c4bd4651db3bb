"""Cables of a robot's hosts pulled and put back, in each behavior: what happens, what is obeyed, when all is ready.

Three network namespaces stand for the hosts. Before the cable is out the robot is brought to a behavior; while it is
out, an operator's ROS 2 program goes on sending: commands of one kind, the last at least 1.5 s before the cable is
back (with shorter cuts: once, at its beginning). What of them the Motion Manager obeys once it is back, it obeys late.

It ends with a table, a row a cut: the behavior when the cable is back and in the end, how long until every process is
ready, what was sent, whether any of it was obeyed late, how far the pelvis moved, and whether the operator is obeyed
again. A cut that fails ends it early, with the reason and the rows until then.

    .venv/bin/python -m benchmarks.cables [--seconds 0.2 2 20] [--hosts motion perception operator] [--behaviors …]
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.tables import Columns, table
from harness.computers import ComputersError
from harness.hosts import Hosts, hosts
from valor.common.resources import robot_folder
from valor.common.topics import HAND_GOAL, VELOCITY
from valor.robot.description import RobotDescription
from valor.valorctl.hosts.deployment import Deployment, deployment_file

INSTANCE = "cables"
NAMES = ("motion", "perception", "operator")
HEALED = 90.0  # [s]
STALE = 1.5  # at the least, of what is sent while the cable is out, once it is back [s]
AFTER = 3.0  # looked at behind everything being ready [s]
PERIOD = 0.1  # between velocities [s]
ASIDE, BACK = 0.3, -0.3  # of the left arm's last joint, before and in the cut [rad]
LOW, HIGH = 0.05, 0.2  # of the left hand over the pelvis, likewise [m]
LATE_PLAN = 100  # index of the first step of the plan sent in the cut


@dataclass(frozen=True)
class Case:
    """A behavior, and who tells of what is sent while the cable is out that it was obeyed."""

    name: str
    mode: str
    begin: str  # the operator's line that begins it; empty: the mode is all
    late: str  # the line sent while the cable is out
    obeyed: Callable[[dict[str, Any]], bool]  # whether a tap's word shows that it was, or that it arrived
    topic: str = ""  # on which it arrives at the Motion Manager, which may refuse it
    repeated: bool = False


_ROBOT = RobotDescription.load(robot_folder("escher"))
_JOINT = _ROBOT.index[_ROBOT.tables.group("left_arm")[-1]]


def _behavior(name: str) -> Callable[[dict[str, Any]], bool]:
    return lambda event: event.get("behavior") == name


def _arm(event: dict[str, Any]) -> bool:
    return event["kind"] == "state" and float(event["setpoint"][_JOINT]) < 0.5 * BACK


def _hand(event: dict[str, Any]) -> bool:
    return bool(event["kind"] == "hand" and event["value"] == HIGH)


def _late_step(event: dict[str, Any]) -> bool:
    return bool(event["kind"] == "step" and event["value"] >= LATE_PLAN)


def _late_velocity(event: dict[str, Any]) -> bool:
    return bool(event["kind"] == "velocity" and event["value"] == 0.151)


CASES = (
    Case("standing", "stand", "", "mode stand_manipulate", _behavior("stand_manipulate")),
    Case("walking", "walk", "velocity 0.15", "velocity 0.151", _late_velocity, VELOCITY.name, repeated=True),
    Case("stepping", "step", "steps 0 12", f"steps {LATE_PLAN} 4", _late_step),
    Case("trajectory", "stand_manipulate", f"arm {ASIDE} 6", f"arm {BACK} 3", _arm),
    Case("hand goal", "stand_manipulate", f"hand {LOW}", f"hand {HIGH}", _hand, HAND_GOAL.name),
    Case("frozen", "freeze", "", "mode stand_prep", _behavior("stand_prep")),
)


@dataclass
class Row:
    """What became of one cut."""

    host: str
    case: str
    seconds: float
    during: str  # behavior when the cable came back
    end: str  # and in the end
    ready: float  # after the cable was back [s]
    sent: int
    arrived: int  # signs at the Motion Manager of what was sent in the cut, behind its end
    refused: int
    moved: float  # of the pelvis, from the cable's return on [m]
    again: str  # whether the operator is obeyed in the end


COLUMNS: Columns[Row] = (
    ("cable of", lambda row: row.host),
    ("behavior", lambda row: row.case),
    ("out [s]", lambda row: f"{row.seconds:g}"),
    ("then", lambda row: row.during),
    ("in the end", lambda row: row.end),
    ("ready [s]", lambda row: f"{row.ready:.1f}"),
    ("sent", lambda row: str(row.sent)),
    ("obeyed late", lambda row: "no" if row.arrived <= row.refused else f"yes ({row.arrived}, {row.refused} refused)"),
    ("moved [mm]", lambda row: f"{1e3 * row.moved:.0f}"),
    ("obeys", lambda row: row.again),
)


class Bench:
    """The hosts, a tap on motion's, an operator's program on the operator's."""

    def __init__(self, computers: Hosts) -> None:
        self._hosts = computers
        self._file = computers.folder / "tap.jsonl"
        self._file.touch()
        self._tap = self._run("motion", "benchmarks.cable_tap", str(self._file))
        self._operator = self._run("operator", "benchmarks.cable_operator")
        assert self._operator.stdout is not None
        self._operator.stdout.readline()
        while self._say("known") != "True":
            time.sleep(0.2)

    def close(self) -> None:
        """End both."""
        for process in (self._tap, self._operator):
            process.kill()  # they hold nothing
            process.wait()

    def _run(self, host: str, module: str, *more: str) -> subprocess.Popen[str]:
        home = self._hosts.home(host)
        return subprocess.Popen(
            self._hosts.command(host, sys.executable, "-m", module, str(home), INSTANCE, *more),
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

    def _state(self) -> dict[str, Any]:
        return [each for each in self._events(time.time() - 5.0) if each["kind"] == "state"][-1]

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
                return (done.stdout + done.stderr).strip().splitlines()[-1][:60]
        return "yes"

    def _stand(self) -> str:
        """From wherever the robot is; why not, else "yes"."""
        stopped = self._state()["behavior"] in ("freeze", "stand_prep", "soft_stop", "idle")
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

    def cut(self, host: str, case: Case, seconds: float) -> Row:
        """One cut."""
        if case.mode != "stand":
            self._mode(case.mode)
        if case.begin:
            self._keep(case.begin, 3.0, case.repeated)
        self._hosts.network.pull(host)
        began = time.monotonic()
        sent = self._keep(case.late, max(0.0, seconds - STALE), case.repeated)
        time.sleep(max(0.0, seconds - (time.monotonic() - began)))
        before, plugged = self._state(), time.time()
        self._hosts.network.plug(host)
        while not self._hosts.status("operator")["ready"] and time.time() - plugged < HEALED:
            time.sleep(0.2)
        ready = time.time() - plugged
        time.sleep(AFTER)
        events = self._events(plugged)
        states = [each for each in events if each["kind"] == "state"]
        arrived = sum(map(case.obeyed, events))
        rejections = [each for each in events if each["kind"] == "rejection"]
        refused = sum(each["value"] == case.topic for each in rejections)
        moved = max(math.dist(each["place"][:2], before["place"][:2]) for each in states)
        end = states[-1]["behavior"]
        again = self._stand()
        row = Row(host, case.name, seconds, before["behavior"], end, ready, sent, arrived, refused, moved, again)
        print(row, *(f"\n   refused: {each['value']}: {each['reason']}" for each in rejections[:3]), flush=True)
        return row


def _run(options: argparse.Namespace) -> list[Row]:
    file = deployment_file("drc")
    text = file.read_text()
    for name, host in Deployment.load(file).hosts.items():
        text = text.replace(host.address, f"@{name}")
    rows: list[Row] = []
    with (
        tempfile.TemporaryDirectory(prefix="vh-", ignore_cleanup_errors=True) as folder,
        hosts(Path(folder), text, INSTANCE, *NAMES, perception=3.0, operator=-2.0) as made,
    ):
        made.valorctl("operator", "up", "--deployment", str(made.file))
        bench = Bench(made)
        try:
            cases = [case for case in CASES if not options.behaviors or case.name in options.behaviors]
            for seconds, host, case in itertools.product(options.seconds, options.hosts, cases):
                row = bench.cut(host, case, seconds)
                rows.append(row)
        except Exception as error:  # what was measured before is worth telling
            print(f"ended early: {type(error).__name__}: {error}", file=sys.stderr)
        finally:
            bench.close()
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, nargs="+", default=[0.2, 2.0, 20.0])
    parser.add_argument("--hosts", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--behaviors", nargs="+", choices=[case.name for case in CASES])
    try:
        rows = _run(parser.parse_args())
    except ComputersError as error:
        sys.exit(str(error))
    title = f"Cables, load {os.getloadavg()[0]:.1f}"
    Console(width=150).print(table(title, COLUMNS, rows, left=["cable of", "behavior"]))


if __name__ == "__main__":
    main()
