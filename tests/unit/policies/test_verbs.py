"""`valorctl policy`: a policy is added to a robot's folder, listed, and checked with every fact's source."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from harness.onnx_file import affine
from harness.places import ROBOTS
from tests.unit.policies.builds import leapp, mjlab, unitree, write
from tests.unit.policies.test_conventions import MJLAB, MOTORS
from valor.common.errors import ConfigurationError, ValorError
from valor.valorctl.terminal.app import app


def valorctl(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["policy", *arguments], env={"COLUMNS": "200"})
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.output


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    return Path(shutil.copytree(ROBOTS / "escher", tmp_path / "own"))


def test_a_policy_is_added_with_all_its_files_listed_and_checked(robot: Path, tmp_path: Path) -> None:
    for name, build, facts in (("a", mjlab, MJLAB), ("b", unitree, MOTORS), ("c", leapp, {})):
        folder = tmp_path / name
        folder.mkdir()
        file = build(folder)
        if facts:
            write(file, facts)
        assert "added" in valorctl("add", str(file), "--robot", str(robot), "--name", name)
    listed = json.loads(valorctl("list", "--robot", str(robot), "--json"))
    assert [(row["policy"], row["joints"], row["period"]) for row in listed] == [
        (name, 4, 0.02) for name in ("a", "b", "c")
    ]
    for name in ("a", "b", "c"):
        checked = json.loads(valorctl("check", name, "--robot", str(robot), "--json", "--no-play"))
        assert checked["trial"]["finite"] and checked["trial"]["acts"] == 100
        assert checked["trial"]["p99"] >= checked["trial"]["median"] > 0
    shown = valorctl("check", "a", "--robot", str(robot), "--no-play")
    assert "metadata joint_stiffness" in shown and "user" in shown and "default" in shown
    (robot / "policies" / "a.yaml").unlink()
    assert "rejected: 2 problems" in valorctl("list", "--robot", str(robot))
    with pytest.raises(ConfigurationError, match=r"a.onnx: exists"):
        valorctl("add", str(write(mjlab(tmp_path / "a"), MJLAB)), "--robot", str(robot), "--name", "a")


def test_targets_that_are_not_finite_are_reported(robot: Path, tmp_path: Path) -> None:
    file = affine(tmp_path / "walk.onnx", {"obs": 3}, {"actions": {"obs": np.full((3, 1), 3e38)}})
    facts = {"joints": ["l_knee_pitch"], "period": 0.02, "observation": [{"term": "velocity_command", "scale": 1e3}],
             "action_scale": 1, "action_offset": 0, "stiffness": 1, "damping": 1}  # fmt: skip
    with pytest.raises(ValorError, match="targets are not finite"):
        valorctl("check", str(write(file, facts)), "--robot", str(robot))


def test_what_is_rejected_is_shown_and_not_added(robot: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="period: unknown"):
        valorctl("add", str(mjlab(tmp_path)), "--robot", str(robot))
    assert not (robot / "policies").exists()
    with pytest.raises(ConfigurationError, match=r"policy 'walk': .*ONNX file"):
        valorctl("check", "walk", "--robot", str(robot))
