"""What demonstrations do when a part of them fails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from valor.common.errors import ValorError
from valor.drawing.errors import RenderingError
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


def test_the_next_commands_find_this_valorctl(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    program, other = tmp_path / ".venv/bin/valorctl", tmp_path / "other/valorctl"
    for each in (program, other):
        each.parent.mkdir(parents=True)
        each.touch(mode=0o755)
    monkeypatch.setattr("sys.executable", str(program.with_name("python")))

    def told(path: Path, folder: Path) -> list[str]:
        monkeypatch.setenv("PATH", str(path))
        monkeypatch.chdir(folder)
        demonstration.suggest(("up", "stands"), ("walk --vx 0.3", "walks"))
        return capsys.readouterr().out.splitlines()[2:]

    assert told(program.parent, tmp_path) == ["  valorctl up             # stands", "  valorctl walk --vx 0.3  # walks"]
    assert told(other.parent, tmp_path)[0] == "  .venv/bin/valorctl up             # stands"
    assert told(other.parent, other.parent)[0] == f"  {program} up             # stands"
