"""Four conventions are read into one contract; what is missing or wrong is rejected by name."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.unit.policies.builds import (
    DAMPING,
    ESCHER,
    JOINTS,
    SCALE,
    STIFFNESS,
    ZERO,
    holosoma,
    leapp,
    mjlab,
    senses,
    unitree,
    weights,
    write,
)
from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.common.rotation import quaternion, vertical
from valor.policies.contract import PolicyError, load
from valor.policies.facts import Source
from valor.policies.observations import Senses
from valor.policies.policy import Policy, Targets

MJLAB = {"period": 0.02, "history_order": "oldest_first"}
MOTORS = {"joints": [JOINTS[i] for i in (1, 3, 0, 2)]}  # motor 2 is joint 0 of the policy
SORTED = {
    "period": 0.02,
    "observation": ["last_action", {"term": "base_angular_velocity", "scale": 0.25}, "yaw_rate_command",
                    {"term": "joint_position_relative", "clip": [-0.5, 0.5]}, "base_linear_velocity"],
    "default_position": dict(zip(JOINTS, ZERO.tolist(), strict=True)), "action_scale": 0.25,
}  # fmt: skip
INDEX = [ESCHER.index[name] for name in JOINTS]


def acts(file: Path, count: int = 3) -> tuple[Policy, list[Senses], list[Targets]]:
    policy, random = Policy(load(file, ESCHER), ESCHER), np.random.default_rng(7)
    states = [senses(random) for _ in range(count)]
    return policy, states, [policy.act(state) for state in states]


def gravity(state: Senses) -> FloatArray:
    return -np.array(vertical(quaternion(state.pelvis_orientation)))


def test_mjlab(tmp_path: Path) -> None:
    policy, states, targets = acts(write(mjlab(tmp_path), MJLAB))
    action, past = np.zeros(4), [states[0].joint_position[INDEX] - ZERO] * 3
    for state, target in zip(states, targets, strict=True):
        past = [*past[1:], state.joint_position[INDEX] - ZERO]
        velocity = state.joint_velocity[INDEX] * [0.5, 0.5, 0.5, 0.25]
        turn = np.clip(state.pelvis_angular_velocity, -1, 1) * 0.25
        observed = np.concatenate([turn, gravity(state), state.velocity_command, *past, velocity, action])
        action = observed @ weights(29)["obs"] + weights(29)[""]
        assert target.position == pytest.approx(ZERO + SCALE * action, abs=1e-5)
        assert (target.stiffness == STIFFNESS).all() and (target.damping == DAMPING).all()
    policy.reset()
    assert [policy.act(state).position.tolist() for state in states] == [each.position.tolist() for each in targets]
    sources = {name: fact.source for name, fact in policy.contract.facts.items()}
    assert (sources["stiffness"], sources["period"]) == (Source.FILE, Source.USER)
    assert (sources["action_offset"], sources["command_ranges"]) == (Source.DEFAULT, Source.UNKNOWN)


def test_holosoma(tmp_path: Path) -> None:
    _, states, targets = acts(write(holosoma(tmp_path), SORTED))
    action = np.zeros(4)
    for state, target in zip(states, targets, strict=True):
        relative = np.clip(state.joint_position[INDEX] - ZERO, -0.5, 0.5)
        turn, rate = state.pelvis_angular_velocity * 0.25, state.velocity_command[2:]
        observed = np.concatenate([action, turn, rate, relative, state.pelvis_linear_velocity])
        action = observed @ weights(15)["obs"]
        assert target.position == pytest.approx(ZERO + 0.25 * action, abs=1e-5)


def test_holosomas_actions_are_clipped_as_by_itself(tmp_path: Path) -> None:
    policy = Policy(load(write(holosoma(tmp_path), SORTED), ESCHER), ESCHER)
    state = senses(np.random.default_rng(0))
    state.pelvis_linear_velocity[:] = 1e6
    assert np.abs(policy.act(state).position - ZERO) == pytest.approx(np.full(4, 25.0))


def test_unitree(tmp_path: Path) -> None:
    policy, states, targets = acts(write(unitree(tmp_path), MOTORS))
    assert policy.contract.joints == JOINTS and policy.contract.period == 0.02
    assert (policy.contract.stiffness == STIFFNESS).all() and (policy.contract.damping == DAMPING).all()
    action, past = np.zeros((2, 4)), [states[0], states[0]]
    for state, target in zip(states, targets, strict=True):
        past = [past[1], state]
        command = np.clip(state.velocity_command, [-0.1, -np.inf, -1], [0.2, np.inf, 1])
        observed = np.concatenate([
            *[0.2 * each.pelvis_angular_velocity for each in past], command,
            *[np.clip(each.joint_position[INDEX] - ZERO, -0.5, 0.5) for each in past], *action,
        ])  # fmt: skip
        action = np.array([action[1], observed @ weights(25)["obs"] + weights(25)[""]])
        assert target.position == pytest.approx(np.clip(ZERO + SCALE * action[1], -0.4, 0.4), abs=1e-5)


def test_leapp(tmp_path: Path) -> None:
    policy, states, targets = acts(leapp(tmp_path))
    random, sizes = np.random.default_rng(3), {"q": 4, "gyro": 3, "quat": 4, "cmd": 3, "last_action": 4}
    net = {name: random.normal(0, 0.1, (size, 4)) for name, size in sizes.items()}
    action, order = np.zeros(4), [2, 1, 3, 0]  # of JOINTS in targets
    assert policy.contract.joints == tuple(JOINTS[i] for i in (3, 1, 0, 2)) and policy.contract.period == 0.02
    for state, target in zip(states, targets, strict=True):
        quat = state.pelvis_orientation[[1, 2, 3, 0]]
        q = state.joint_position[INDEX[::-1]]
        given = q @ net["q"] + state.pelvis_angular_velocity @ net["gyro"] + quat @ net["quat"]
        given += state.velocity_command @ net["cmd"] + action @ net["last_action"]
        action = given
        assert target.position == pytest.approx(given, abs=1e-5)
        assert (target.stiffness[order] == STIFFNESS).all() and (target.damping[order] == DAMPING).all()
    policy.reset()
    assert np.allclose([policy.act(state).position for state in states], [target.position for target in targets])


def test_leapps_states_start_from_its_file(tmp_path: Path) -> None:
    file, start = leapp(tmp_path, pipeline={"initial_values": "x_initial_values.safetensors"}), np.arange(4.0)
    header = json.dumps({"net/last_action": {"dtype": "F32", "shape": [1, 4], "data_offsets": [0, 16]}}).encode()
    data = len(header).to_bytes(8, "little") + header + start.astype("<f4").tobytes()
    (tmp_path / "x_initial_values.safetensors").write_bytes(data)
    fed = [Policy(load(file, ESCHER), ESCHER), Policy(load(leapp(tmp_path), ESCHER), ESCHER)]
    targets = [policy.act(senses(np.random.default_rng(7))).position for policy in fed]
    random = np.random.default_rng(3)
    weight = [random.normal(0, 0.1, (size, 4)) for size in (4, 3, 4, 3, 4)][-1]
    assert targets[0] - targets[1] == pytest.approx(start @ weight, abs=1e-5)


def test_leapps_connections_back_may_be_a_list(tmp_path: Path) -> None:
    connections = [{"source": "net/action", "target": "net/last_action"}]
    pipeline = {"feedback_flow": None, "feedback_connections": connections}
    assert load(leapp(tmp_path, pipeline=pipeline), ESCHER).feedback == {"last_action": "action"}


def test_recurrent_states_are_fed_back_by_their_names(tmp_path: Path) -> None:
    from harness.onnx_file import affine

    file = affine(
        tmp_path / "r.onnx", {"obs": 3, "h_in": 2},
        {"actions": {"h_in": np.array([[1.0], [10.0]])}, "h_out": {"obs": np.eye(3)[:, :2], "h_in": np.eye(2)}},
    )  # fmt: skip
    facts: dict[str, Any] = dict.fromkeys(("default_position", "stiffness", "damping"), 0.0)
    facts |= {"joints": ["l_knee_pitch"], "period": 0.02, "action_scale": 1, "action_offset": 0}
    policy, states, targets = acts(write(file, facts | {"observation": ["velocity_command"]}))
    assert targets[0].position == 0.0
    expected = (states[0].velocity_command + states[1].velocity_command)[:2] @ [1, 10]
    assert targets[2].position == pytest.approx([expected])
    policy.reset()
    assert policy.act(states[0]).position == 0.0


REJECTED: dict[str, tuple[Callable[..., Path], dict[str, Any], dict[str, Any], str]] = {
    "no period": (mjlab, {}, {"history_order": "oldest_first"}, "period: unknown"),
    "a frequency": (mjlab, {}, MJLAB | {"period": 50}, r"period: 50; .*no frequency"),
    "between periods": (mjlab, {}, MJLAB | {"period": 0.0213}, r"period: 0.0213 s; .*control period, 0.002 s"),
    "no order of history": (mjlab, {}, {"period": 0.02}, "history_order: unknown"),
    "a strange joint": (mjlab, {"joint_names": "l_hip_pitch,left_knee,r_hip_pitch,r_knee_pitch"}, MJLAB,
                        r"joint_names left_knee: .*no joint of escher"),
    "a joint twice by another name": (mjlab, {}, MJLAB | {"joint_names": {"l_knee_pitch": "l_hip_pitch"}},
                                      "joints l_hip_pitch: twice"),
    "a joint twice": (mjlab, {"joint_names": "l_hip_pitch,l_hip_pitch,r_hip_pitch,r_knee_pitch"}, MJLAB,
                      "joints l_hip_pitch: twice"),
    "too few gains": (mjlab, {"joint_stiffness": "1,2,3"}, MJLAB, "stiffness: 3 values; expected 4"),
    "no gains": (mjlab, {"joint_damping": None}, MJLAB, "damping: unknown"),
    "a negative gain": (mjlab, {"joint_damping": "1,2,-3,4"}, MJLAB, "damping of r_hip_pitch: -3"),
    "gains that are no numbers": (mjlab, {"joint_damping": "1,x,3,4"}, MJLAB, "damping: metadata joint_damping: 1,x"),
    "not finite": (mjlab, {"action_scale": "1,nan,3,4"}, MJLAB, "action_scale of l_knee_pitch: nan"),
    "degrees": (mjlab, {"default_joint_pos": "-17,34,-11,29"}, MJLAB, r"default_position of l_knee_pitch: 34; .*rad"),
    "an unknown term": (mjlab, {"observation_names": "base_ang_vel,projected_gravity,command,joint_pos,x,actions"},
                        MJLAB, "observation x: not known here"),
    "the command of a motion": (mjlab, {"command_names": "motion"}, MJLAB, r"observation command \(motion\): not"),
    "a size": (mjlab, {"observation_names": "base_ang_vel,projected_gravity,joint_vel,joint_pos,joint_vel,actions"},
               MJLAB, r"observation: 30 numbers .*; expected 29"),
    "a list of scales": (mjlab, {"observation_terms_scale": "1,1"}, MJLAB, "observation: 2 values of .*scale"),
    "a scale": (mjlab, {"observation_terms_scale": "1;1,1,1,1,1,1"}, MJLAB, "observation base_ang_vel: scale"),
    "an offset": (mjlab, {}, MJLAB | {"observation": [{"term": "velocity_command", "offset": [1, 2]}]},
                  r"observation velocity_command: offset \(1.0, 2.0\); expected 1 or 3 numbers"),
    "histories of two dimensions": (mjlab, {"observation_terms_flatten_history_dim": ",".join(["False"] * 6)}, MJLAB,
                                    "observation joint_pos: .*dimension"),
    "holosoma's gaps": (holosoma, {}, {}, r"(?s)(?=.*default_position: )(?=.*observation: unk)(?=.*action_scale: unk)"),
    "no JSON": (mjlab, {"kp": "[1"}, SORTED, "stiffness: metadata kp"),
    "a range": (holosoma, {"command_ranges": {"lin_vel_x": [1, -1]}}, SORTED, r"command_ranges: .*\[1, -1\]"),
    "no names of motors": (unitree, {}, {}, "joints: unknown; expected the names of all motors"),
    "a motor twice": (unitree, {"joint_ids_map": [0, 0, 1, 2]}, MOTORS, "joint_ids_map: "),
    "an index of joints": (unitree, {"observations": {"joint_pos_rel": {"params": {"asset_cfg": {"joint_ids": [1]}},
                                                                        "scale": [1.0]}}}, MOTORS,
                           "joint_pos_rel: not"),
    "torques": (unitree, {"actions": {"JointEffortAction": {}}}, MOTORS, "outputs: JointEffortAction"),
    "no step": (unitree, {"step_dt": None}, MOTORS, "period: unknown"),
    "text for a step": (unitree, {"step_dt": "fast"}, MOTORS, "deploy.yaml: ValueError"),
    "a clip": (unitree, {"actions": {"JointPositionAction": {"scale": 1, "offset": 0, "clip": [[1, -1]] * 4}}}, MOTORS,
               "position_clip: "),
    "a frame": (leapp, {"inputs": {"gyro": {"kind": "state/body/angular_velocity", "shape": [1, 3],
                                            "isaaclab_connection": "state:robot:root_ang_vel_w"}}}, {},
                r"observation gyro .*: not known"),
    "a kind": (leapp, {"inputs": {"gyro": {"kind": "state/wrench", "shape": [1, 3]}}}, {},
               r"gyro \(state/wrench\): not"),
    "an order of quaternions": (leapp, {"inputs": {"quat": {"kind": "state/body/rotation", "shape": [1, 4]}}}, {},
                                "quaternion_order: unknown"),
    "an order of elements": (leapp, {"inputs": {"cmd": {"kind": "command/body/velocity", "shape": [1, 3],
                                                        "element_names": [["ang_vel_z", "lin_vel_x", "lin_vel_y"]]}}},
                             {}, r"observation cmd .*: not known"),
    "no names": (leapp, {"outputs": {"kp": {"kind": "kp", "shape": [1, 4]}}}, {}, "outputs.kp: kind kp, element_names"),
    "another output": (leapp, {"outputs": {"kp": {"kind": "kp", "shape": [1, 4], "name": "gains",
                                                  "element_names": [list(JOINTS)]}}}, {}, "outputs.stiffness: gains"),
    "targets of later": (leapp, {"outputs": {"kp": {"kind": "kp", "shape": [1, 4], "element_names": [list(JOINTS)],
                                                    "temporal_period_ms": 20}}}, {}, "outputs.kp: kind kp"),
    "other joints": (leapp, {"outputs": {"kp": {"kind": "kp", "shape": [1, 4],
                                                "element_names": [[*JOINTS[:3], "r_elbow_pitch"]]}}}, {},
                     "outputs.stiffness: other joints: r_elbow_pitch, r_knee_pitch"),
    "a shape": (leapp, {"inputs": {"gyro": {"kind": "state/body/angular_velocity", "shape": [1, 6]}}}, {},
                r"observation gyro .*: size 6; expected 3"),
    "a state without output": (leapp, {"inputs": {"last_action": {"shape": [1, 4], "is_state": True}},
                                       "pipeline": {"feedback_flow": {}}}, {}, "feedback.last_action: last_action,"),
    "sizes of feedback": (leapp, {}, {"feedback": {"gyro": "action", "last_action": "action"}},
                          "feedback.gyro: action"),
    "constants": (mjlab, {}, MJLAB | {"constants": {"obs": [1.0]}}, "constants.obs: 1 values"),
    "a clip without order": (mjlab, {"observation_terms_clip": "1;-1" + ",-inf;inf" * 5}, MJLAB,
                             r"observation base_ang_vel: clip \(1.0, -1.0\)"),
    "a name for none": (mjlab, {}, MJLAB | {"joint_names": {"tail": "neck"}},
                        "joint_names tail: no joint of the policy"),
    "no default position": (holosoma, {}, SORTED | {"observation": [{"term": "joint_position_relative",
                                                                     "joints": ["l_elbow_pitch"]}]},
                            "joint_position_relative: l_elbow_pitch; expected joints with a default"),
    "an input": (holosoma, {}, SORTED | {"observation": [{"term": "last_action", "input": "x"}]}, "input 'x'"),
    "a body": (leapp, {"outputs": {"x": {"kind": "target/body/position", "shape": [1, 4]}}}, {}, "outputs.x: kind"),
    "no rate": (leapp, {"pipeline": {"configs": {}}}, {}, "period: unknown"),
    "feedback": (leapp, {"pipeline": {"feedback_flow": {"net/x": ["net/last_action"]}}}, {}, "feedback.last_action: x"),
}  # fmt: skip


@pytest.mark.parametrize("name", REJECTED)
def test_what_is_wrong_is_rejected_by_name(name: str, tmp_path: Path) -> None:
    build, changes, facts, expected = REJECTED[name]
    with pytest.raises(ConfigurationError) as caught:
        load(write(build(tmp_path, **changes), facts), ESCHER)
    assert re.search(expected, str(caught.value)), str(caught.value)


def test_all_problems_are_in_one_error_with_what_is_known(tmp_path: Path) -> None:
    with pytest.raises(PolicyError) as caught:
        load(mjlab(tmp_path, joint_stiffness=None, joint_names=",".join([*JOINTS[:3], "tail"])), ESCHER)
    lines = str(caught.value).splitlines()
    assert len(lines) == len(caught.value.faults) == 4
    assert all("expected" in line and "walk.yaml" in line for line in lines)
    assert caught.value.facts["damping"].source == Source.FILE


def test_a_sidecar_replaces_facts_and_their_problems(tmp_path: Path) -> None:
    file = mjlab(tmp_path, joint_damping="1,x", joint_names=",".join([*JOINTS[:3], "tail"]))
    contract = load(write(file, MJLAB | {"damping": 7, "joint_names": {"tail": JOINTS[3]}}), ESCHER)
    assert contract.joints == JOINTS and (contract.damping == 7).all()
    assert contract.facts["damping"].source == Source.USER


def test_a_wrong_key_of_a_sidecar_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"walk.yaml:1:1: perod"):
        load(write(mjlab(tmp_path), {"perod": 0.02}), ESCHER)
