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
from valor.valorctl.instance import startup
from valor.valorctl.terminal.console import Interruption, Progress

SERVICES = {
    "bifrostd", "motion_manager", "comms_manager", "valor_ros_controller", "footstep_converter", "bag_recorder",
}  # fmt: skip


def assert_within_budgets(rows: dict[str, list[float]], factor: float) -> None:
    """Largest memory; three times the budget of processor time per robot time, for a busy computer."""
    for name, (mean, *_, most) in rows.items():
        budget = PROCESSES[name]
        assert most <= budget.memory_budget, f"{name}: {most:.0f} MiB"
        assert mean / factor <= 3.0 * budget.cpu_budget, f"{name}: {mean:.0f} % at {factor:.2f} of real time"


def test_an_experiment_measures_each_process(system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    instance = Instance(system.name, Path(system.environment["VALOR_HOME"]))
    monkeypatch.setattr(startup, "running", lambda *_: nullcontext(instance.settings()))
    experiment, options = BY_NAME["process-stats"], Options(tmp_path, quick=True)
    result, file = experiment.perform(instance, options, Progress(), Interruption())
    assert Result.load(file) == result
    (table,) = result.tables
    rows = {row[0]: [float(value) for value in row[1:]] for row in table.rows}
    assert set(rows) >= SERVICES
    for name, (mean, deviation, largest, smallest, memory, most) in rows.items():
        assert 0.0 <= smallest <= mean <= largest and 0.0 <= deviation <= largest - smallest + 0.1, name
        assert 1.0 < memory <= most, name
    assert rows["motion_manager"][0] > 1.0, "it controls a robot"
    numbers = {measure.name: measure.value for measure in result.measures}
    assert numbers["VRC memory, mean"] == pytest.approx(rows["valor_ros_controller"][4], abs=0.1)
    assert numbers["whole system, mean"] == pytest.approx(sum(row[0] for row in rows.values()), abs=0.1 * len(rows))
    factor = numbers["robot time against the wall's"] or 0.0
    assert factor > 0.0
    assert_within_budgets(rows, factor)
    with open(tmp_path / "process_stats.csv") as opened:
        assert len(opened.readlines()) > 3
    assert all((tmp_path / picture.file).stat().st_size > 5_000 for picture in result.pictures)
