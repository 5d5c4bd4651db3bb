"""The generated model has the masses of the source model, and the same kinematics at any angles."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.places import ROBOTS
from tests.unit.robot_setup.builds import BUILDS, written
from valor.common.arrays import FloatArray
from valor.robot_setup import model_xml
from valor.robot_setup.new import draft_robot
from valor.robot_setup.skeleton import Skeleton

DRAWN = [*sorted(BUILDS), "escher", "thor"]


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Skeleton, mujoco.MjModel]]:
    pairs = {}
    for name in DRAWN:
        own = ROBOTS / name / "model.xml"
        file = own if own.exists() else written(BUILDS[name], tmp_path_factory.mktemp("model"))
        draft = draft_robot(file, "robot")
        robot = draft.robot
        pairs[name] = robot, mujoco.MjModel.from_xml_string(model_xml.render(robot, draft.geometry, "robot"))
    return pairs


def seen_from_pelvis(mj: mujoco.MjModel, data: mujoco.MjData, pelvis: int, turn: FloatArray) -> FloatArray:
    """Return every body's centre of mass, (n, 3) [m]."""
    places: FloatArray = (data.xipos - data.xpos[pelvis]) @ data.xmat[pelvis].reshape(3, 3) @ turn
    return places


@pytest.mark.parametrize("name", DRAWN)
@examples(10)
@given(st.integers(0, 2**32 - 1))
def test_bodies_are_where_the_source_has_them(
    pairs: dict[str, tuple[Skeleton, mujoco.MjModel]], name: str, seed: int
) -> None:
    robot, made = pairs[name]
    maker = robot.source.mj
    drawn, copy = mujoco.MjData(maker), mujoco.MjData(made)
    random = np.random.default_rng(seed)
    for joint in sorted(robot.driven):
        angle = random.uniform(-1.5, 1.5)
        drawn.qpos[maker.jnt_qposadr[joint]] = angle
        copy.joint(robot.joint_name(joint)).qpos[0] = angle
    mujoco.mj_kinematics(maker, drawn)
    mujoco.mj_kinematics(made, copy)
    turn = robot.source.rotation(robot.pelvis).T @ robot.forward
    wanted = seen_from_pelvis(maker, drawn, robot.pelvis, turn)
    there = seen_from_pelvis(made, copy, made.body(robot.name(robot.pelvis)).id, np.eye(3))
    for body in robot.edges:
        if maker.body_mass[body] > 0:
            assert there[made.body(robot.name(body)).id] == pytest.approx(wanted[body], abs=1e-5)


@pytest.mark.parametrize("name", DRAWN)
def test_masses_and_inertias_are_the_sources(pairs: dict[str, tuple[Skeleton, mujoco.MjModel]], name: str) -> None:
    robot, made = pairs[name]
    maker = robot.source.mj
    assert made.body_mass.sum() == pytest.approx(maker.body_mass[list(robot.edges)].sum(), rel=1e-4)
    for body in robot.edges:
        own = made.body(robot.name(body))
        assert own.mass[0] == pytest.approx(maker.body_mass[body], rel=1e-5)
        assert np.sort(own.inertia) == pytest.approx(np.sort(maker.body_inertia[body]), rel=1e-4, abs=2e-9)


def test_a_coarser_mesh_stays_near_the_finer_one() -> None:
    sphere = trimesh.creation.icosphere(5)
    coarse, kept = model_xml.coarsen(sphere.vertices, sphere.faces.astype(np.int32), 0.1)
    assert len(kept) < len(sphere.faces) / 5
    assert np.linalg.norm(coarse, axis=1) == pytest.approx(1.0, abs=0.05)
