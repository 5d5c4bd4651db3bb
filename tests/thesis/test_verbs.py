"""What there is to repeat, and what is refused before anything is started."""

from importlib import metadata
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from thesis.experiments.table import EXPERIMENTS
from valor.valorctl.__main__ import run as main
from valor.valorctl.terminal import app


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["valorctl", *arguments])
    try:
        return main()
    except SystemExit as end:
        return int(end.code or 0)


def test_a_distribution_whose_verbs_cannot_be_loaded_is_named_and_costs_no_other_verb(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = EntryPoint("thesis", "thesis.gone:register", app.ADDED)
    monkeypatch.setattr(metadata, "entry_points", lambda group: [broken] if group == app.ADDED else [])
    app._added.cache_clear()
    try:
        assert run(monkeypatch, "experiment") == 2
        assert "thesis: its verbs cannot be loaded (ModuleNotFoundError" in capsys.readouterr().err
        assert run(monkeypatch, "robot", "--help") == 0
    finally:
        app._added.cache_clear()


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        (("experiment", "walking"), "experiment 'walking': expected one of process-stats, ipc-latency"),
        (("experiment", "tracking", "--with-clients"), "--with-clients applies only to process-stats"),
        (("report", "nowhere"), "no results of experiments"),
    ],
)
def test_others_are_rejected(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    arguments: tuple[str, ...],
    reported: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, *arguments) == 1
    assert reported in capsys.readouterr().err.replace("\n", " ")


def test_all_of_them_are_tried_and_the_report_names_what_failed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path / "home"))
    out = tmp_path / "out"
    assert run(monkeypatch, "experiment", "all", "--quick", "--robot", "nowhere", "--out", str(out)) == 1
    said = capsys.readouterr()
    page = (out / "report" / "report.html").read_text()
    assert run(monkeypatch, "experiment") == 0
    listed = capsys.readouterr().out
    for each in EXPERIMENTS:
        assert each.name in listed and each.reproduces in listed and f"{each.name} failed: " in said.err
        assert f"valorctl experiment {each.name} --quick --seed 0" in page
    assert page.count("nowhere") >= 2 * len(EXPERIMENTS)
    assert (out / "report" / "README.md").exists()
