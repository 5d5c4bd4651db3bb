"""The pathways through the Valor ROS Controller on one host against three, in one run.

Network namespaces with cables to one switch stand for the computers: what the split adds is that messages leave over
an interface instead of loopback, that ROS 2 goes to peers, and that stamps are brought from one clock to another (those
of the three are 5 s apart). All share the processors of the one computer, so its load is the same in both.

    .venv/bin/python -m benchmarks.hosts [--seconds 20] [--changes 40] [--commands 40]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks import pathways
from benchmarks.tables import Columns, table
from harness.computers import ComputersError
from harness.hosts import Hosts, deployment_text, hosts

OPERATOR = "operator"


@dataclass
class Row:
    """One line of the table: samples [s] of one host, and of three."""

    pathway: str
    one: list[float]
    three: list[float]


def _ms(samples: list[float], quantile: float) -> str:
    return f"{1e3 * float(np.quantile(samples, quantile)):.2f}"


COLUMNS: Columns[Row] = (
    ("pathway", lambda row: row.pathway),
    ("one host: median", lambda row: _ms(row.one, 0.5)),
    ("95 %", lambda row: _ms(row.one, 0.95)),
    ("three: median", lambda row: _ms(row.three, 0.5)),
    ("95 % ", lambda row: _ms(row.three, 0.95)),
    ("median, three − one", lambda row: f"{1e3 * float(np.median(row.three) - np.median(row.one)):+.2f}"),
)


def measured(computers: Hosts, options: argparse.Namespace, *up: str) -> dict[str, list[float]]:
    """Samples [s] by pathway, as the operator's computer sees them, of a system brought up with options."""
    result = computers.folder / "samples.json"
    amounts = [f"--{name}={getattr(options, name)}" for name in ("seconds", "changes", "commands")]
    command = [sys.executable, pathways.__file__, *amounts, f"--json={result}", f"--home={computers.home(OPERATOR)}"]
    environment = computers.environment(OPERATOR) | {"PYTHONPATH": str(Path(__file__).parents[1])}
    subprocess.run(computers.command(OPERATOR, *command, "--", *up), env=environment, check=True)
    found: dict[str, list[float]] = json.loads(result.read_text())
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="of state, and of floor")
    parser.add_argument("--changes", type=int, default=40, help="of the control mode")
    parser.add_argument("--commands", type=int, default=40, help="of a joint")
    options = parser.parse_args()
    text = deployment_text("drc")
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="vh-", ignore_cleanup_errors=True) as folder:
        try:
            names = ("motion", "perception", OPERATOR)
            with hosts(Path(folder), text, pathways.INSTANCE, *names, perception=3.0, operator=-2.0) as made:
                one = measured(made, options)
                three = measured(made, options, "--deployment", str(made.file))
        except ComputersError as error:
            sys.exit(str(error))
    rows = [Row(pathway, one[pathway], three[pathway]) for pathway in one if one[pathway] and three.get(pathway)]
    title = f"Pathways [ms], load {load:.1f} before and {os.getloadavg()[0]:.1f} after, {os.cpu_count()} cores"
    Console(width=130).print(table(title, COLUMNS, rows, left=["pathway"]))


if __name__ == "__main__":
    main()
