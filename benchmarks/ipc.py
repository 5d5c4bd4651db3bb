"""Bifrost beside other ways to pass messages between Python processes: latency, CPU time, cost as a network grows.

    python benchmarks/ipc.py [--quick] [--transports bifrost,pyzmq] [--seconds 120] [--parts latency,growth] [--json F]

Everything is measured in one run. At 10 Hz all transports and payloads run at the same time, staggered; at 500 Hz and
flat out they take turns in short slices, several rounds, so that the machine's load falls alike on all: trust the
ratios. The ratio is of medians, slice by slice, to bare pyzmq with CURVE. A latency counts from before a message is
encoded until it is decoded. CPU time is that of both processes, all threads, a message received; "nothing" shows what
the pacing takes. At 10 Hz it is the mean of all payloads, idling included. "busy" is the share of the machine's cores
in use by everybody.

Other transports than Bifrost and pyzmq are in the dependency group ``bench`` (``make bench`` installs it); those that
are missing are skipped with a word.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import bifrost
from benchmarks.interprocess import growth, latency
from benchmarks.interprocess.ends import End, serve
from benchmarks.interprocess.payloads import SIZES
from benchmarks.interprocess.transports import TRANSPORTS

HEADER = ("transport", "over", "median", "99 %", "mean", "sd", "ratio", "CPU", "received/s", "lost", "busy")
ROW = "{:<20}{:<16}{:>8}{:>9}{:>8}{:>9}{:>7}{:>8}{:>12}{:>7}{:>6}"


def _load() -> str:
    return "load " + " ".join(f"{value:.1f}" for value in os.getloadavg())


def _table(rows: list[latency.Row], title: str) -> list[dict[str, Any]]:
    """Print rows of one rate, payload by payload; returns them for JSON."""
    plain = []
    for payload in dict.fromkeys(row.payload for row in rows):
        some = [row for row in rows if row.payload == payload]
        reference = next((row for row in some if row.transport == latency.REFERENCE), None)
        print(f"\n{payload} ({SIZES[payload]} B), {title}, [µs]; {_load()}")
        print(ROW.format(*HEADER))
        for row in some:
            told = latency.as_plain(row, reference)
            plain.append(told)
            over = TRANSPORTS[row.transport.removesuffix(latency.THREADS)].over
            numbers = [f"{told[key]:.0f}" if key in told else "-" for key in ("median", "p99", "mean", "sd")]
            ratio = f"{told['ratio']:.2f}" if told.get("ratio") else "-"
            received = f"{told['received_per_second']:.0f}" if row.received else "-"
            lost = f"{told['lost'] * 100:.0f} %" if row.received else "-"
            cells = (ratio, f"{told['cpu']:.0f}", received, lost, f"{told['busy']:.0f} %")
            print(ROW.format(row.transport, over, *numbers, *cells), flush=True)
    return plain


def _latency(options: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    names = latency.available(options.transports)
    slow, slices, rounds = (10.0, 0.3, 2) if options.quick else (options.seconds, 0.5, 4)
    plain: list[dict[str, Any]] = []
    threads = [f"{name}{latency.THREADS}" for name in names]
    with latency.pairs([*names, *threads], list(SIZES), folder, dict(os.environ)) as ready:
        if not ready:
            return plain
        plain += _table(latency.together(ready, 10.0, slow), "10 Hz, all at once")
        plain += _table(latency.in_turn(ready, 500.0, slices, rounds), "500 Hz")
        between = [pair for pair in ready if not pair.name.endswith(latency.THREADS)]
        plain += _table(latency.in_turn(between, 0.0, slices / 2, max(2, rounds // 2)), "flat out")
    return plain


def _transports(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in TRANSPORTS:
            raise argparse.ArgumentTypeError(f"{name!r}: expected some of {', '.join(TRANSPORTS)}")
    return names


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a look, in a minute: short slices, small networks")
    parser.add_argument("--transports", type=_transports, default=list(TRANSPORTS), help=", ".join(TRANSPORTS))
    parser.add_argument("--seconds", type=float, default=120.0, help="at 10 Hz; the thesis took two minutes")
    parser.add_argument("--parts", default="latency,growth", help="latency, growth or both")
    parser.add_argument("--json", type=Path, help="write all numbers to this file")
    parser.add_argument("--end", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.end:
        serve(options.end, {"open": End, "crowd": growth.Crowd})
        return
    began = time.monotonic()
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="ipc-") as name:
        folder = Path(name)
        bifrost.Network.create(folder / "network.json", folder / "keys")
        os.environ |= {"BIFROST_NETWORK": str(folder / "network.json"), "BIFROST_KEYS": str(folder / "keys")}
        os.environ |= {"OPENBLAS_NUM_THREADS": "1", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
        os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        daemon = subprocess.Popen([sys.executable, "-m", "bifrost.daemon"], stderr=subprocess.DEVNULL)
        try:
            if "latency" in options.parts:
                results["latency"] = _latency(options, folder)
            if "growth" in options.parts:
                results["growth"] = growth.measure(folder, daemon.pid, options.quick)
        finally:
            daemon.terminate()
            daemon.wait()
    print(f"\ntook {time.monotonic() - began:.0f} s; {_load()}")
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
