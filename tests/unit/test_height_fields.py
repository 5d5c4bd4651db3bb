"""Height fields as triangles: as MuJoCo has them, and coarser."""

import mujoco
import numpy as np
import pytest

from valor.simulation.height_fields import triangles

ROWS, COLUMNS, HALF = 6, 9, (2.0, 1.0)


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    heights = np.random.default_rng(1).uniform(0.0, 1.0, ROWS * COLUMNS)
    spec.add_hfield(name="h", nrow=ROWS, ncol=COLUMNS, size=[*HALF, 0.5, 0.1], userdata=heights.tolist())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="h")
    return spec.compile()


def test_they_lie_where_mujocos_rays_end_and_face_upwards(model: mujoco.MjModel) -> None:
    vertices, faces = triangles(model, 0)
    assert (len(vertices), len(faces)) == (ROWS * COLUMNS, 2 * (ROWS - 1) * (COLUMNS - 1))
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0.0).all()
    assert normals[:, 2].sum() / 2.0 == pytest.approx(4.0 * HALF[0] * HALF[1]), "all of it, nothing twice"
    data, geom = mujoco.MjData(model), np.zeros(1, np.int32)
    mujoco.mj_forward(model, data)
    for x, y, z in vertices[(np.abs(vertices[:, 0]) < HALF[0]) & (np.abs(vertices[:, 1]) < HALF[1])]:
        way = mujoco.mj_ray(model, data, np.array((x, y, 5.0)), np.array((0.0, 0.0, -1.0)), None, 1, -1, geom)
        assert 5.0 - way == pytest.approx(z, abs=1e-4)


def test_coarser_ones_have_some_of_the_same_points(model: mujoco.MjModel) -> None:
    fine, _ = triangles(model, 0)
    coarse, faces = triangles(model, 0, 2.0 * 2.0 * HALF[0] / (COLUMNS - 1) + 1e-9)
    assert len(coarse) == -(-ROWS // 2) * -(-COLUMNS // 2) and faces.max() == len(coarse) - 1
    known = {tuple(point) for point in np.round(fine, 9).tolist()}
    assert all(tuple(point) in known for point in np.round(coarse, 9).tolist())
