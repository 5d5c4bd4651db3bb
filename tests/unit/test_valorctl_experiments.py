"""What there is to repeat, and what is refused before anything is started."""

from __future__ import annotations

from pathlib import Path

import pytest

from valorctl.__main__ import main
from valorctl.experiments.table import EXPERIMENTS


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
