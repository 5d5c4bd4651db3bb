"""What there is to repeat, and what is refused before anything is started."""

from importlib import metadata
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from tests.conftest import Valorctl
from thesis.experiments.table import EXPERIMENTS
from valor.valorctl.terminal import app


def test_a_distribution_whose_verbs_cannot_be_loaded_is_named_and_costs_no_other_verb(
    monkeypatch: pytest.MonkeyPatch, valorctl: Valorctl
) -> None:
    broken = EntryPoint("thesis", "thesis.gone:register", app.ADDED)
    monkeypatch.setattr(metadata, "entry_points", lambda group: [broken] if group == app.ADDED else [])
    app._added.cache_clear()
    try:
        status, _, err = valorctl("experiment")
        assert status == 2 and "thesis: its verbs cannot be loaded (ModuleNotFoundError" in err
        assert valorctl("robot", "--help")[0] == 0
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
    monkeypatch: pytest.MonkeyPatch, valorctl: Valorctl, tmp_path: Path, arguments: tuple[str, ...], reported: str
) -> None:
    monkeypatch.chdir(tmp_path)
    status, _, err = valorctl(*arguments)
    assert status == 1 and reported in err.replace("\n", " ")


def test_all_are_tried_and_failures_named(monkeypatch: pytest.MonkeyPatch, valorctl: Valorctl, tmp_path: Path) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path / "home"))
    out = tmp_path / "out"
    status, _, said = valorctl("experiment", "all", "--quick", "--robot", "nowhere", "--out", str(out))
    assert status == 1
    page = (out / "report" / "report.html").read_text()
    status, listed, _ = valorctl("experiment")
    assert status == 0
    for each in EXPERIMENTS:
        assert each.name in listed and each.reproduces in listed and f"{each.name} failed: " in said
        assert f"valorctl experiment {each.name} --quick --seed 0" in page
    assert page.count("nowhere") >= 2 * len(EXPERIMENTS)
    assert (out / "report" / "README.md").exists()
