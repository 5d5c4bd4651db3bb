"""What is found of an arm is what its data were made with."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.closed_loop import load_robot
from harness.examples import examples
from harness.robot_in_process import RobotInProcess
from valor.calibration import dynamics, servo
from valor.calibration.identify import UnidentifiedError, identify
from valor.calibration.poses import CLEAR, Poses
from valor.calibration.record import Record, Recorder
from valor.common.arrays import FloatArray
from valor.common.messages import JointMode
from valor.robot.model import full_model

ROBOT = load_robot()
ARM = "right_arm"
JOINTS = tuple(ROBOT.tables.group(ARM))
PLACES = ROBOT.group_indices(ARM)
MODEL = full_model(ROBOT)
STEP = 0.02  # [s]
seeds = st.integers(0, 2**31)
widths = st.one_of(st.just(0.0), st.floats(0.004, 0.07))


def sway(rng: np.random.Generator, count: int, low: FloatArray, high: FloatArray) -> FloatArray:
    """(3, count, m) smooth motions between limits: position, velocity, acceleration."""
    t = STEP * np.arange(count)[:, None]
    rates, phases = rng.uniform(0.5, 1.5, (2, len(low))), rng.uniform(0.0, 6.3, (2, len(low)))
    middle, reach = 0.5 * (low + high), 0.25 * (high - low)
    made = np.zeros((3, count, len(low)))
    made[0] = middle
    for rate, phase in zip(rates, phases, strict=True):
        angle = t * rate + phase
        made += reach * np.array((np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)))
    return made


@given(seeds, st.sampled_from([0.0, 1.0]), st.floats(0.3, 1.3), widths)
@examples(30)
def test_the_law_of_a_drive_is_found(seed: int, share: float, strength: float, half: float) -> None:
    rng = np.random.default_rng(seed)
    count, k, d = 1500, 300.0, 12.0
    error = sway(rng, count, np.array([-1.0]), np.array([1.0]))[0, :, 0]
    error *= 0.15 / np.abs(error).max()  # beyond every play
    rate_error, ahead = rng.normal(0.0, 0.05, count), rng.normal(0.0, 6.0, count)
    dead = error - np.clip(error, -half, half)
    effort = strength * (share * ahead + k * dead + d * rate_error) + rng.normal(0.0, 0.25, count)
    found = servo.identify(
        error=error + rng.normal(0.0, 1e-4, count),
        rate_error=rate_error,
        feed_forward=ahead,
        stiffness=np.full(count, k),
        damping=np.full(count, d),
        effort=effort,
    )
    assert found.strength == pytest.approx(strength, rel=0.03)
    assert found.share == pytest.approx(share, abs=0.05)
    assert (found.half_play or 0.0) == pytest.approx(half, abs=0.0012)
    assert found.residual < 0.5


def test_play_that_never_shows_is_not_claimed() -> None:
    rng = np.random.default_rng(0)
    inside, nothing = rng.uniform(-0.02, 0.02, 500), np.zeros(500)
    found = servo.identify(
        error=inside,
        rate_error=nothing,
        feed_forward=nothing,
        stiffness=nothing + 300.0,
        damping=nothing,
        effort=rng.normal(0.0, 0.3, 500),
    )
    assert found.half_play is None


@given(seeds)
@examples(30)
def test_of_a_drive_that_only_noise_is_heard_of_nothing_is_claimed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, k, d = 1500, 20.0, 0.5
    ahead, error, rate_error = 0.02 * rng.normal(0.0, [[1.0], [0.1], [0.1]], (3, count))
    found = servo.identify(
        error=error,
        rate_error=rate_error,
        feed_forward=ahead,
        stiffness=np.full(count, k),
        damping=np.full(count, d),
        effort=ahead + k * error + d * rate_error + rng.normal(0.0, 0.25, count),
    )
    assert (found.share, found.strength, found.half_play) == (1.0, 1.0, None)


def swaying(seed: int, count: int = 1500) -> tuple[Record, dict[str, FloatArray]]:
    """Of an arm whose links and friction are drawn, and what was drawn."""
    rng = np.random.default_rng(seed)
    motion = sway(rng, count, np.maximum(ROBOT.lower[PLACES], -2.0), np.minimum(ROBOT.upper[PLACES], 2.0))
    mj = copy.copy(MODEL.mj)
    for body in dynamics.links(MODEL, JOINTS):
        mj.body_mass[body] *= rng.uniform(0.75, 1.25)
        mj.body_ipos[body] += rng.uniform(-0.02, 0.02, 3)
    drawn = {"friction": rng.uniform(0.5, 6.0, 7), "damping": rng.uniform(0.1, 1.5, 7), "offset": rng.normal(0, 0.3, 7)}
    dofs = np.array([int(mj.joint(name).dofadr[0]) for name in JOINTS])
    mj.dof_damping[dofs] = 0.0
    data = mujoco.MjData(mj)
    n = len(ROBOT.joints)
    position, velocity, effort = (np.zeros((count, n)) for _ in range(3))
    position[:] = ROBOT.nominal_posture
    position[:, PLACES], velocity[:, PLACES] = motion[0], motion[1]
    for t in range(count):
        data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        data.qpos[MODEL.qpos] = position[t]
        data.qvel[dofs], data.qacc[dofs] = motion[1, t], motion[2, t]
        mujoco.mj_inverse(mj, data)
        effort[t, PLACES] = data.qfrc_inverse[dofs]
    rubs = drawn["friction"] * np.sign(motion[1]) + drawn["damping"] * motion[1] + drawn["offset"]
    effort[:, PLACES] += rubs + rng.normal(0.0, 0.3, motion[1].shape)
    upright, nothing = np.tile((1.0, 0.0, 0.0, 0.0), (count, 1)), np.zeros((count, n))
    stiffness = nothing + ROBOT.servo_stiffness
    record = Record(
        np.linspace(0.0, STEP * (count - 1), count), upright, position, velocity, effort,
        position + effort / ROBOT.servo_stiffness, velocity, nothing, stiffness, nothing + ROBOT.servo_damping,
    )  # fmt: skip
    return record, drawn


@given(seeds)
@examples(5)
def test_friction_and_links_are_found(seed: int) -> None:
    record, drawn = swaying(seed)
    found = identify(MODEL, ARM, record, 1)
    for j, name in enumerate(JOINTS):
        joint = found.table.joints[name]
        assert joint.friction == pytest.approx(drawn["friction"][j], abs=0.25), name
        assert joint.damping == pytest.approx(drawn["damping"][j], abs=0.3), name
        assert joint.backlash is None
        assert joint.effort_share == pytest.approx(0.0, abs=0.05)
        assert joint.residual < 0.6 < found.nominal_residual[name]
    off = found.torques.measured - found.torques.found
    assert np.sqrt(np.mean(off[found.torques.moving] ** 2)) < 0.5
    other, _ = swaying(seed, 400)  # the same arm's first moments: no more than noise is left in them
    assert np.sqrt(np.mean((other.effort[:, PLACES] - found.torques.found[:400]) ** 2)) < 0.6


def test_an_arm_as_the_table_says_stays_so() -> None:
    record, _ = swaying(3)
    regressor = dynamics.Regressor(MODEL, JOINTS)
    velocity, effort = record.velocity[:, PLACES], record.effort.copy()
    nominal, _ = dynamics._modelled(regressor, record, PLACES.tolist())
    effort[:, PLACES] = nominal + 2.0 * np.sign(velocity) + 0.5 * velocity
    same = Record(*(effort if name == "effort" else getattr(record, name) for name in Record.__dataclass_fields__))
    _, links, _ = dynamics.identify(MODEL, JOINTS, same)
    for name, link in links.items():
        body = MODEL.mj.body(name).id
        assert link.mass == pytest.approx(float(MODEL.mj.body_mass[body]), rel=0.01)
        np.testing.assert_allclose(link.com, MODEL.mj.body_ipos[body], atol=0.002)


def test_an_arm_that_hardly_moved_is_not_found() -> None:
    record, _ = swaying(0, 300)
    record.velocity[:, PLACES[2]] = 0.01
    with pytest.raises(UnidentifiedError, match=f"{ARM}: not enough to go by: {JOINTS[2]} moved in 0 moments of 300"):
        identify(MODEL, ARM, record, 1)


def test_poses_keep_off_the_body_and_lead_back() -> None:
    home = ROBOT.nominal_posture
    poses = Poses(full_model(ROBOT, "collision"), ARM, home)
    reached = [poses.next() for _ in range(4)]
    assert all((goal > ROBOT.lower[PLACES]).all() and (goal < ROBOT.upper[PLACES]).all() for goal in reached)
    way = poses.back(0.5 * (reached[2] + reached[3]), 3)
    np.testing.assert_array_equal(way[-1], home[PLACES])
    inside = home.copy()
    inside[ROBOT.index["r_shoulder_roll"]] = 0.5  # across the chest
    inside[ROBOT.index["r_shoulder_yaw"]] = 1.5
    assert not poses.clear(home, inside[PLACES]), f"{CLEAR} m off everything"


def test_a_record_averages_periods_and_takes_position_servos_as_they_are() -> None:
    robot = RobotInProcess(ROBOT, "ideal", 0)
    recorder = Recorder(ROBOT)
    upright = np.array((1.0, 0.0, 0.0, 0.0))
    robot.each = lambda: recorder.add(robot.measured, robot.motor, upright)
    robot.run(0.1)
    assert len(recorder) == 10
    record = recorder.record()
    assert len(recorder) == 0
    assert np.diff(record.time) == pytest.approx(0.01)
    neck = ROBOT.index["neck_yaw"]
    assert robot.motor.mode[neck] == JointMode.POSITION
    assert (record.stiffness[:, neck] == ROBOT.servo_stiffness[neck]).all()
