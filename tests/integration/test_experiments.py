"""The thesis' experiments as a person runs them, in their short form, and the report of them."""

import csv
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from harness.system import System, leftovers, shared_memory
from thesis.verbs import INSTANCE


@pytest.fixture
def system(home: Path) -> System:
    return System(INSTANCE, home)


def measured(folder: Path, experiment: str) -> tuple[dict[str, Any], dict[str, float]]:
    """A result, and its numbers by name."""
    result = json.loads((folder / experiment / "result.json").read_text())
    assert result["quick"]
    for file in [*result["files"], *(picture["file"] for picture in result["pictures"])]:
        assert (folder / experiment / file).stat().st_size > 100
    return result, {measure["name"]: measure["value"] for measure in result["measures"]}


def test_experiments_leave_results_and_a_report_gathers_them(system: System, home: Path) -> None:
    before = shared_memory()
    out = home / "out"

    def run(on: System, name: str) -> None:
        output = on.valorctl("experiment", name, "--quick", "--seed", "2", "--out", str(out), timeout=170.0).stdout
        assert str(out / name / "result.json") in output

    with ThreadPoolExecutor(1) as beside:  # messages between two ends load nothing
        other = System("messages", home)
        latencies = beside.submit(run, other, "ipc-latency")
        for name in ("tracking", "pathway-latency"):
            run(system, name)
        latencies.result()

    result, numbers = measured(out, "ipc-latency")
    assert [row[-1] for row in result["tables"][0]["rows"]] == ["0"] * 4  # nothing was lost: both ways are reliable
    assert 0.0 < numbers["Bifrost, mean"] < 1e5 and 0.0 < numbers["ROS 2 (rclpy, Fast DDS), mean"] < 1e5

    result, numbers = measured(out, "tracking")
    assert result["settings"]["seed"] == "2"
    assert numbers["arm joint at rest from its goal, largest"] < 0.05
    assert numbers["neck yaw at rest from its goal"] < 0.05
    assert 0.0 < numbers["encoder after motor command, mean"] < 200.0

    result, numbers = measured(out, "pathway-latency")
    samples = {row[0]: int(row[5]) for row in result["tables"][0]["rows"]}
    assert len(samples) == 8
    assert all(samples.values()), samples
    assert samples["Mode change reported"] == 3
    for pathway in ("mode change", "proprioception", "joint command by stamps"):
        assert 0.0 < numbers[f"{pathway}, hardware"] < 2000.0
    assert numbers["joint command to the first milliradian, hardware"] > numbers["joint command by stamps, hardware"]
    for rate in ("control tick", "motor commands", "joint states"):
        came = float(result["settings"][f"{rate} came at"].split()[0])
        assert came > 10.0 and f"{rate} came at {came:.0f} Hz" in result["text"]
    assert result["settings"]["control tick asked for at"] == "500 Hz"
    with open(out / "pathway-latency" / "pathway_latency.csv") as file:
        stamped = [float(row["latency_ms"]) for row in csv.DictReader(file) if row["method"] == "stamps"]
    assert min(stamped) >= 0.0
    costs = {row[0]: [float(value) for value in row[2:5]] for row in result["tables"][2]["rows"]}
    assert len(costs) == 5
    for whole, floor, less in costs.values():
        assert floor > 0.0 and less == pytest.approx(whole - floor, abs=0.02)

    output = system.valorctl("report", str(out)).stdout
    assert "3 of 5 experiments" in output and "not run: process-stats, end-effector" in output
    assert (out / "report" / "report.html").stat().st_size > 100_000
    assert (out / "report" / "README.md").stat().st_size > 5_000
    for name in (system.name, other.name):
        assert leftovers(home, name, before) == []
