"""The experiment on the processes, on the shared system instead of a separate one."""

from contextlib import nullcontext
from pathlib import Path

import pytest

from harness.system import System
from thesis.experiments.experiment import Options
from thesis.experiments.table import BY_NAME
from thesis.report.results import Result
from valor.common.instance import Instance
from valor.common.processes import BY_NAME as PROCESSES
from valor.robot.description import RobotDescription
from valor.valorctl.instance import startup
from valor.valorctl.terminal.console import Interruption, Progress

SERVICES = {
    "bifrostd", "motion_manager", "comms_manager", "valor_ros_controller", "footstep_converter", "bag_recorder",
}  # fmt: skip


def measured(result: Result) -> dict[str, float]:
    return {measure.name: measure.value or 0.0 for measure in result.measures}


def assert_within_budgets(rows: dict[str, list[float]], factor: float) -> None:
    """Largest memory; three times the budget of processor time per robot time, for a busy computer."""
    for name, (mean, most) in rows.items():
        budget = PROCESSES[name]
        assert most <= budget.memory_budget, f"{name}: {most:.0f} MiB"
        assert mean / factor <= 3.0 * budget.cpu_budget, f"{name}: {mean:.0f} % at {factor:.2f} of real time"


def test_an_experiment_measures_each_process(system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    instance = Instance(system.name, Path(system.environment["VALOR_HOME"]))
    monkeypatch.setattr(startup, "running", lambda *_: nullcontext(instance.settings()))
    experiment, options = BY_NAME["process-stats"], Options(tmp_path, quick=True)
    result, file = experiment.perform(instance, options, Progress(), Interruption())
    assert Result.load(file) == result
    table, processes = result.tables
    rows = {row[0]: [float(value) for value in row[1].split(", ")] for row in processes.rows}
    assert set(rows) >= SERVICES
    assert rows["motion_manager"][0] > 1.0, "it controls a robot"
    # Columns: the thesis' two, that of this system, and why it differs.
    shown = {row[0]: row[3] for row in table.rows}
    mean, deviation, largest, smallest = (
        float(shown[f"VRC processor, {name}"]) for name in ("mean", "sd", "max", "min")
    )
    assert 0.0 <= smallest <= mean <= largest and 0.0 <= deviation <= largest - smallest + 0.1
    assert mean == rows["valor_ros_controller"][0] == pytest.approx(measured(result)["VRC processor, mean"], abs=0.05)
    assert float(shown["whole system"]) == pytest.approx(sum(row[0] for row in rows.values()), abs=0.1 * len(rows))
    factor = measured(result)["robot time against the wall's"]
    assert float(shown["VRC processor a robot second"]) == pytest.approx(mean / factor, rel=0.05, abs=0.1)
    control = RobotDescription.load(instance.settings().robot, instance.settings().control_rate).tables.control_rate
    asked = {name: row.split(", ")[0] for name, row in shown.items() if "asked for and came" in name}
    assert asked["control tick, asked for and came [Hz]"] == f"{control:.0f}"
    assert asked["joint states, asked for and came [Hz]"] == f"{min(250.0, control):.0f}"
    assert_within_budgets(rows, factor)
    with open(tmp_path / "process_stats_sim.csv") as opened:
        assert len(opened.readlines()) > 3
    assert all((tmp_path / picture.file).stat().st_size > 5_000 for picture in result.pictures)
