"""What there is to repeat, and what is refused before anything is started."""

from __future__ import annotations

from pathlib import Path

import pytest

from valor.valorctl.__main__ import run as main
from valor.valorctl.experiments.table import EXPERIMENTS


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["valorctl", *arguments])
    try:
        return main()
    except SystemExit as end:
        return int(end.code or 0)


def test_the_experiments_are_listed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(monkeypatch, "experiment") == 0
    told = capsys.readouterr().out
    for each in EXPERIMENTS:
        assert each.name in told
        assert each.reproduces in told


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ("experiment", "walking"),
            "experiment 'walking': expected one of process-stats, ipc-latency",
        ),
        (("experiment", "tracking", "--beside"), "experiment tracking: --beside is of process-stats"),
        (("report", "nowhere"), "no results of experiments"),
    ],
)
def test_others_are_refused(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    arguments: tuple[str, ...],
    told: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, *arguments) == 1
    assert told in capsys.readouterr().err.replace("\n", " ")


def test_all_of_them_are_tried_and_the_report_tells_what_failed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path / "home"))
    out = tmp_path / "out"
    assert run(monkeypatch, "experiment", "all", "--quick", "--robot", "nowhere", "--out", str(out)) == 1
    said = capsys.readouterr()
    page = (out / "report" / "report.html").read_text()
    for each in EXPERIMENTS:
        assert f"{each.name} failed: " in said.err
        assert f"valorctl experiment {each.name} --quick --seed 0" in page
    assert page.count("nowhere") >= 2 * len(EXPERIMENTS)
    assert (out / "report" / "README.md").exists()
    assert (out / "report" / "report.pdf").exists()
