"""What demonstrations do when a part of them fails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from valor.analysis.errors import RenderingError
from valor.common.errors import ValorError
from valor.valorctl import demonstration
from valor.valorctl.console import Progress
from valor.valorctl.interruption import InterruptedBySignalError, Interruption


def drawing(file: Path) -> Callable[[], list[Path]]:
    def draw() -> list[Path]:
        file.write_bytes(b"picture")
        return [file]

    return draw


def without_opengl() -> list[Path]:
    raise RenderingError("no off-screen OpenGL here")


def test_where_one_picture_cannot_be_drawn_the_others_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, last = tmp_path / "first.png", tmp_path / "last.png"
    failures = demonstration.Failures()
    drawings = [("a", drawing(first)), ("b", without_opengl), ("c", drawing(last))]
    made = demonstration.draw(drawings, failures, Progress(), Interruption())
    assert made == [first, last]
    demonstration.tell([tmp_path / "absent.mcap", *made], Progress())
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [str(first), str(last)]
    with pytest.raises(RenderingError, match="no off-screen OpenGL here"):
        failures.tell()


def test_the_first_failure_is_told() -> None:
    failures = demonstration.Failures()
    failures.tell()  # none: nothing
    for text in ("the robot fell", "no walk in the bag"):
        with failures.kept():
            raise ValorError(text)
    with pytest.raises(ValorError, match="the robot fell"):
        failures.tell()


def test_who_wants_to_stop_is_not_kept_waiting() -> None:
    failures = demonstration.Failures()
    with pytest.raises(InterruptedBySignalError), failures.kept():
        raise InterruptedBySignalError(2)
    failures.tell()


def test_the_next_commands_are_called_as_this_one_was(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("sys.argv", [str(tmp_path / ".venv/bin/valorctl"), "demo"])
    demonstration.suggest(("up", "stands"), ("walk --vx 0.3", "walks"))
    assert capsys.readouterr().out.splitlines() == [
        "",
        "next:",
        "  .venv/bin/valorctl up             # stands",
        "  .venv/bin/valorctl walk --vx 0.3  # walks",
    ]
    program = tmp_path / "valorctl"
    program.touch(mode=0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    demonstration.suggest(("up", "stands"))
    assert "  valorctl up  # stands" in capsys.readouterr().out
