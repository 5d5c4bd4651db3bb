"""Histories have the stated order; joints are by name, whatever their order in the file; gaits follow the command."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.onnx_file import BIAS, affine
from tests.unit.policies.builds import DAMPING, ESCHER, JOINTS, SCALE, STIFFNESS, ZERO, senses, weights, write
from valor.policies.contract import load
from valor.policies.policy import Policy


@given(length=st.integers(1, 6), count=st.integers(1, 9), newest=st.booleans(), zeros=st.booleans())
@settings(max_examples=40, deadline=None)
def test_histories(length: int, count: int, newest: bool, zeros: bool) -> None:
    size = 3 * length + 2
    with TemporaryDirectory() as folder:
        file = affine(Path(folder) / "h.onnx", {"obs": size}, {"actions": {"obs": np.eye(size)}})
        write(file, {
            "joints": list(ESCHER.joints[:size]), "period": 0.002, "action_scale": 1, "action_offset": 0,
            "default_position": 0, "stiffness": 1, "damping": 1,
            "history_order": "newest_first" if newest else "oldest_first",
            "history_start": "zeros" if zeros else "repeat",
            "observation": [{"term": "base_angular_velocity", "history": length},
                            {"term": "linear_velocity_command", "scale": [1.2, 1], "offset": [-0.2, 0.1]}],
        })  # fmt: skip
        policy = Policy(load(file, ESCHER), ESCHER)
    random = np.random.default_rng(count)
    states = [senses(random) for _ in range(count)]
    targets = [policy.act(state) for state in states]
    first = np.zeros(3) if zeros else states[0].pelvis_angular_velocity
    past = ([first] * length + [state.pelvis_angular_velocity for state in states])[-length:]
    expected = np.concatenate(
        [*(past[::-1] if newest else past), [1.2, 1] * states[-1].velocity_command[:2] + [-0.2, 0.1]]
    )
    assert targets[-1].position == pytest.approx(expected, abs=1e-6)


@given(order=st.permutations(range(4)), seed=st.integers(0, 99))
@settings(max_examples=25, deadline=None)
def test_the_order_of_joints_in_the_file_does_not_matter(order: list[int], seed: int) -> None:
    given, straight = weights(15, seed=seed), list(range(4))
    policies = []
    for each in (straight, order):
        rows = [*[4 * block + i for block in range(3) for i in each], 12, 13, 14]
        data = {"obs": given["obs"][rows][:, each], BIAS: given[BIAS][each]}
        lists = {"default_position": ZERO, "action_scale": SCALE, "stiffness": STIFFNESS, "damping": DAMPING}
        with TemporaryDirectory() as folder:
            file = affine(Path(folder) / "p.onnx", {"obs": 15}, {"actions": data})
            facts = {"joints": [JOINTS[i] for i in each], "period": 0.02, "action_offset": "default_position",
                     "observation": ["joint_position_relative", "joint_velocity", "last_action", "projected_gravity"],
                     **{name: values[each].tolist() for name, values in lists.items()}}  # fmt: skip
            policies.append(Policy(load(write(file, facts), ESCHER), ESCHER))
    random = np.random.default_rng(seed)
    for _ in range(3):
        state = senses(random)
        for role in ("position", "stiffness", "damping"):
            by_robot = [np.zeros(len(ESCHER.joints)), np.zeros(len(ESCHER.joints))]
            for values, policy in zip(by_robot, policies, strict=True):
                values[policy.indices] = getattr(policy.act(state), role)
            assert by_robot[1] == pytest.approx(by_robot[0], abs=1e-5)


def test_gaits_advance_with_the_policy_and_rest_while_the_command_is_zero(tmp_path: Path) -> None:
    file = affine(tmp_path / "g.onnx", {"obs": 6}, {"actions": {"obs": np.eye(6)}})
    facts = {"joints": list(ESCHER.joints[:6]), "period": 0.02, "action_scale": 1, "action_offset": 0, "stiffness": 1,
             "damping": 1, "observation": ["gait_sin", "gait_cos", "gait_clock"],
             "gait": {"period": 0.08, "offsets": [0.0, 1.0], "standing": 3.0}}  # fmt: skip
    policy, state = Policy(load(write(file, facts), ESCHER), ESCHER), senses(np.random.default_rng(0))
    for command, phases in ((0.3, (0, 1)), (0.3, (np.pi / 2, 1 + np.pi / 2)), (0.0, (3, 3)), (0.3, (0, 1))):
        state.velocity_command[:] = [command, 0.0, 0.0]
        expected = [*np.sin(phases), *np.cos(phases), np.sin(phases[0]), np.cos(phases[0])]
        assert policy.act(state).position == pytest.approx(expected, abs=1e-6)
