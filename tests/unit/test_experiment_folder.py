"""An experiment whose folder is taken away while it runs: one clear error, whatever the experiment came to."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.valorctl.console import Progress
from valor.valorctl.experiments.experiment import Experiment, Options, Run
from valor.valorctl.interruption import Interruption


def ends(run: Run) -> None:
    """Well."""
    shutil.rmtree(run.out)


def draws(run: Run) -> None:
    """By what it cannot write."""
    shutil.rmtree(run.out)
    (run.out / "picture.png").write_bytes(b"")


def fails(run: Run) -> None:
    """By a reason of its own."""
    shutil.rmtree(run.out)
    raise ValorError("the robot fell")


@pytest.mark.parametrize(
    ("run", "told"),
    [
        (ends, "{out}/result.json: No such file or directory: expected the folder to stay .*; the result is lost"),
        (draws, "{out}/failure.json: No such file .* the experiment had ended with FileNotFoundError: .*picture.png'"),
        (fails, "the robot fell"),
    ],
)
def test_a_folder_that_vanishes_is_one_clear_error(tmp_path: Path, run: Callable[[Run], None], told: str) -> None:
    out = tmp_path / "out"
    experiment = Experiment("gone", "Gone", "", run)
    with pytest.raises(ValorError) as caught:
        experiment.perform(Instance("nobody", tmp_path), Options(out, quick=True), Progress(), Interruption())
    assert re.fullmatch(told.format(out=re.escape(str(out))), str(caught.value)), caught.value
    assert not out.exists()
