"""Files that are no policies are rejected in one line; policies of strangers are run as by themselves."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import yaml

from harness.onnx_file import BIAS, affine
from harness.places import REPOSITORY
from harness.strangers import PLAYGROUND, ROBOTS, facts, policy_of, stranger
from tests.unit.policies.builds import ESCHER, robot_with, senses, weights, write
from valor.common.document import Document
from valor.common.errors import ConfigurationError
from valor.common.rotation import quaternion, vertical
from valor.common.table import checked
from valor.policies.contract import PolicyError, load
from valor.policies.facts import FACTS, Sidecar
from valor.policies.model_file import ModelFile
from valor.policies.observations import TERMS
from valor.policies.policy import Policy

NAN = {"actions": {"obs": np.full((3, 2), np.nan), BIAS: np.zeros(2)}}
SOUND = {"actions": weights(3, 2)}


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("missing", "No such file"), ("text", "is not an ONNX file"), ("empty", "is not an ONNX file"),
        ("huge", "has 1024 MiB; expected a policy of at most 100 MiB"), ("pipe", "is no regular file"),
        ("huge data", "has 1024 MiB"), ("no data", "external data are missing"), ("opset", "opset"),
        ("nan", "output 'actions' is not finite"), ("truncated", "is not an ONNX file"),
    ],
)  # fmt: skip
def test_no_policies(what: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "p.onnx"
    if what in {"text", "empty"}:
        file.write_text("hello" if what == "text" else "")
    elif what == "pipe":
        os.mkfifo(file)
    elif what != "missing":
        outputs = NAN if what == "nan" else SOUND
        affine(file, {"obs": 3}, outputs, opset=99 if what == "opset" else 17,
               external="p.onnx.data" if "data" in what else None)  # fmt: skip
    if what.startswith("huge"):
        with (file if what == "huge" else tmp_path / "p.onnx.data").open("ab") as opened:
            opened.truncate(1 << 30)
    if what == "truncated":
        file.write_bytes(file.read_bytes()[:-20])
    with pytest.raises(ConfigurationError, match=message) as caught:
        ModelFile(file).require_finite()
    assert str(file) in str(caught.value) and "\n" not in str(caught.value)


def test_without_onnxruntime_the_command_is_named(tmp_path: Path) -> None:
    affine(tmp_path / "p.onnx", {"obs": 3}, SOUND)
    hidden = "import sys; sys.modules['onnxruntime'] = None; from pathlib import Path\n"
    code = f"{hidden}from valor.policies.model_file import ModelFile; ModelFile(Path({str(tmp_path / 'p.onnx')!r}))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "onnxruntime is not installed here" in result.stderr
    assert "pip install 'valor[policies]'" in result.stderr


def test_one_thread_evaluates(tmp_path: Path) -> None:
    model, threads = ModelFile(affine(tmp_path / "p.onnx", {"obs": 3}, SOUND)), Path("/proc/self/task")
    code = f"""if True:
    from pathlib import Path
    import onnxruntime
    from valor.policies.model_file import ModelFile
    before = len(list(Path("{threads}").iterdir()))
    model = ModelFile(Path({str(model.file)!r}))
    model.require_finite()
    print(len(list(Path("{threads}").iterdir())) - before)
    """
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "0\n"


@pytest.mark.parametrize("name", ["fastsac_g1_29dof", "ppo_g1_29dof", "fastsac_t1_29dof", "ppo_t1_29dof"])
def test_policies_of_strangers_act_as_their_observations_are_defined(name: str, tmp_path: Path) -> None:
    file, made = stranger(name, tmp_path), name[-8:-6]
    zero, (turn, joint) = np.array(ROBOTS[made].standing), ROBOTS[made].scales
    names = json.loads(onnxruntime.InferenceSession(str(file)).get_modelmeta().custom_metadata_map["dof_names"])
    robot = robot_with(sorted(names))
    policy = Policy(load(write(file, facts(made)), robot), robot)
    session, action, random = onnxruntime.InferenceSession(str(file)), np.zeros(29), np.random.default_rng(2)
    index = [robot.index[each] for each in names]
    for step in range(4):
        state = senses(random, robot)
        state.velocity_command[:] = [0.3, 0.1, -0.2]
        phase = np.array([0, np.pi]) + 2 * np.pi * 0.02 * step
        down = -np.array(vertical(quaternion(state.pelvis_orientation)))
        observed = np.concatenate([
            action, turn * state.pelvis_angular_velocity, [-0.2], [0.3, 0.1], np.cos(phase),
            state.joint_position[index] - zero, joint * state.joint_velocity[index], down, np.sin(phase),
        ])  # fmt: skip
        (given,) = session.run(None, {"actor_obs": observed[None].astype(np.float32)})
        action = np.clip(given[0], -100, 100)
        assert policy.act(state).position == pytest.approx(zero + 0.25 * action, abs=1e-3)


@pytest.mark.parametrize("name", ["apollo", "berkeley_humanoid", "g1", "t1"])
def test_policies_of_mujoco_playground_are_complete_with_their_sidecars(name: str, tmp_path: Path) -> None:
    file = policy_of(name, PLAYGROUND, tmp_path)
    robot = robot_with(sorted(yaml.safe_load(file.with_suffix(".yaml").read_text())["joints"]))
    contract = load(file, robot)
    target = Policy(contract, robot).act(senses(np.random.default_rng(4), robot))
    assert np.isfinite(target.position).all() and target.position.shape == (len(robot.joints),)
    assert contract.stiffness.min() > 0 and contract.gait is not None


def test_the_dance_is_rejected_by_the_terms_that_are_not_known_here(tmp_path: Path) -> None:
    file = stranger("ppo_g1_29dof_dancing", tmp_path)
    terms = ["last_action", "base_angular_velocity", "joint_position_relative", "joint_velocity", "motion_command"]
    with pytest.raises(PolicyError, match="motion_command: not known here"):
        load(write(file, facts("g1") | {"observation": terms}), ESCHER)


def test_the_page_shows_a_valid_sidecar_of_every_fact_and_names_every_term() -> None:
    page = (REPOSITORY / "docs" / "controllers.md").read_text()
    shown = next(block for block in re.findall(r"```yaml\n(.*?)```", page, re.DOTALL) if "history_order" in block)
    content = Document(Path("shown.yaml"), shown.encode()).content
    assert isinstance(content, dict) and set(content) == set(FACTS)
    checked(Sidecar, content)
    assert [name for name in TERMS if f"`{name}`" not in page] == []
