"""A robot is exported to mjlab; what mjlab makes of it comes back as a policy without a sidecar."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from harness.onnx_file import affine
from harness.places import ROBOTS as OWN
from harness.strangers import ROBOTS
from tests.unit.policies.builds import csv, weights
from tests.unit.policies.test_verbs import valorctl
from valor.common.errors import ConfigurationError
from valor.policies.contract import Contract, load
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot_setup.new import new_robot

OBSERVED = ("base_lin_vel", "base_ang_vel", "projected_gravity", "joint_pos", "joint_vel", "actions", "command")


@pytest.fixture(scope="module", params=["escher", "thor", "g1"])
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RobotDescription:
    if request.param in ROBOTS:
        folder = tmp_path_factory.mktemp("robots") / request.param
        new_robot(ROBOTS[request.param].model(), folder, request.param)
        return RobotDescription.load(folder)
    return RobotDescription.load(OWN / request.param)


@pytest.fixture(scope="module")
def package(robot: RobotDescription, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package in a folder that `policy export` writes."""
    folder = tmp_path_factory.mktemp("export") / "training"
    said = valorctl("export", str(folder), "--robot", str(robot.folder))
    assert f"train Valor-Velocity-{robot.name}" in said
    with pytest.raises(ConfigurationError, match="expected a new folder"):
        valorctl("export", str(folder), "--robot", str(robot.folder))
    return folder / f"{robot.name}_mjlab"


def opened(package: Path) -> tuple[mujoco.MjModel, dict[str, Any]]:
    """Model on ground as mjlab's, and the facts."""
    spec = mujoco.MjSpec.from_file(str(package / "robot.xml"))
    spec.worldbody.add_geom(name="terrain", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 0.05))
    spec.option.timestep, spec.option.integrator = 0.005, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec.compile(), json.loads((package / "robot.json").read_text())


def test_the_model_is_the_robots(robot: RobotDescription, package: Path) -> None:
    (mj, facts), own = opened(package), full_model(robot).mj
    assert {mj.body(i).name: mj.body_mass[i] for i in range(mj.nbody)} == pytest.approx(
        {own.body(i).name: own.body_mass[i] for i in range(own.nbody)}
    )
    names = [mj.joint(i).name for i in range(1, mj.njnt)]
    assert names == list(facts["default_position"]) == [mj.actuator(i).name for i in range(mj.nu)]
    assert {*robot.tables.group("left_leg"), *robot.tables.group("right_arm")} <= set(names)
    for i, name in enumerate(names):
        joint, table = mj.joint(name), robot.tables.joints[name]
        assert joint.range == pytest.approx((table.lower, table.upper)) and joint.armature == table.armature
        assert mj.actuator_forcerange[i] == pytest.approx((-table.effort, table.effort))
        assert 0 < mj.actuator_gainprm[i, 0] <= table.servo.stiffness
        asked = facts["action_scale"][name] * mj.actuator_gainprm[i, 0]
        assert asked == pytest.approx(0.25 * table.effort)


def test_it_stands_on_its_soles(robot: RobotDescription, package: Path) -> None:
    mj, facts = opened(package)
    data = mujoco.MjData(mj)
    data.qpos[2] = facts["height"]
    data.qpos[7:] = data.ctrl[:] = list(facts["default_position"].values())
    mujoco.mj_forward(mj, data)
    assert [abs(data.site(site).xpos[2]) < 2e-3 for site in facts["soles"]] == [True, True]
    touching = set[str]()
    for _ in range(20):  # 0.1 s
        mujoco.mj_step(mj, data)
        touching |= {mj.geom(geom).name for pair in data.contact.geom for geom in pair}
    assert len(touching & set(facts["sole_geoms"])) > 3 and touching <= {"terrain", *facts["sole_geoms"]}
    assert data.qpos[2] > 0.95 * facts["height"]
    assert data.sensor("imu_lin_vel").data == pytest.approx(data.qvel[:3], abs=0.1)


def test_the_task_uses_facts_that_are_there(robot: RobotDescription, package: Path) -> None:
    text, (mj, facts) = (package / "__init__.py").read_text(), opened(package)
    compile(text, "task", "exec")
    assert set(re.findall(r"""ROBOT\[["'](\w+)["']\]""", text)) | {"period", "command_ranges"} == set(facts)
    legs = {facts["pose_deviation"][name] for name in robot.tables.group("left_leg")}
    assert legs == {0.15, 0.35} and set(facts["pose_deviation"]) == set(facts["default_position"])
    for body in (*facts["feet"], facts["base"], facts["chest"]):
        assert mj.body(body).id > 0


def exported(package: Path, folder: Path, **changes: str) -> Path:
    """Metadata as mjlab 1.6 writes them for that task: facts have three decimals."""
    mj, facts = opened(package)
    joints = list(facts["default_position"])
    size, count = 12 + 3 * len(joints), len(OBSERVED)
    metadata = {
        "run_path": "local", "joint_names": csv(joints),
        "joint_stiffness": csv(mj.actuator_gainprm[:, 0].tolist()),
        "joint_damping": csv((-mj.actuator_biasprm[:, 2]).tolist()),
        "default_joint_pos": csv(facts["default_position"].values()), "command_names": "twist",
        "observation_names": csv(OBSERVED), "observation_terms_scale": csv([1.0] * count),
        "observation_terms_flatten_history_dim": csv([True] * count),
        "observation_terms_history_length": csv([0] * count),
        "observation_terms_clip": csv(["-inf;inf"] * count),
        "action_scale": csv(facts["action_scale"].values()),
        "valor": json.dumps({fact: facts[fact] for fact in ("period", "command_ranges")}),
    } | changes  # fmt: skip
    return affine(folder / "walk.onnx", {"obs": size}, {"actions": weights(size, len(joints))}, metadata)


def test_its_policy_comes_back_without_a_sidecar(robot: RobotDescription, package: Path, tmp_path: Path) -> None:
    contract: Contract = load(exported(package, tmp_path), robot)
    (mj, facts), index = opened(package), [robot.index[name] for name in contract.joints]
    assert contract.period == facts["period"] == pytest.approx(0.02)
    assert contract.command_ranges[1, 0] == robot.tables.walking.max_forward_speed
    assert contract.facts["period"].where == "metadata valor"
    assert contract.stiffness == pytest.approx(mj.actuator_gainprm[:, 0], abs=1e-3)
    assert contract.default_position == pytest.approx(robot.nominal_posture[index], abs=1e-3)
    assert [term.name for term in contract.observation][-2:] == ["last_action", "velocity_command"]
    assert np.isfinite(contract.damping).all() and contract.damping.min() > 0
    with pytest.raises(ConfigurationError, match=r"metadata valor: .*period"):
        load(exported(package, tmp_path, valor='{"period": "fast"}'), robot)
