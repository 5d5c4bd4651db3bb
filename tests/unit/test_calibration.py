"""Identification of an arm: it finds the parameters that its data were made with."""

import copy

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.closed_loop import load_robot
from harness.examples import examples
from harness.robot_in_process import RobotInProcess
from valor.calibration import dynamics
from valor.calibration.identify import Servo, UnidentifiedError, identify, identify_servo
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


def identified(
    error: FloatArray, rate_error: FloatArray, ahead: FloatArray, effort: FloatArray, k: float, d: float
) -> Servo:
    return identify_servo(
        error=error, rate_error=rate_error, feed_forward=ahead, stiffness=np.full(error.size, k),
        damping=np.full(error.size, d), effort=effort,
    )  # fmt: skip


@given(seeds, st.sampled_from([0.0, 1.0]), st.floats(0.3, 1.3), widths)
@examples(30)
def test_parameters_of_a_drive_are_found(seed: int, share: float, strength: float, half: float) -> None:
    rng = np.random.default_rng(seed)
    count, k, d = 1500, 300.0, 12.0
    error = sway(rng, count, np.array([-1.0]), np.array([1.0]))[0, :, 0]
    error *= 0.15 / np.abs(error).max()  # beyond every play
    rate_error, ahead = rng.normal(0.0, 0.05, count), rng.normal(0.0, 6.0, count)
    dead = error - np.clip(error, -half, half)
    effort = strength * (share * ahead + k * dead + d * rate_error) + rng.normal(0.0, 0.25, count)
    found = identified(error + rng.normal(0.0, 1e-4, count), rate_error, ahead, effort, k, d)
    assert found.strength == pytest.approx(strength, rel=0.03) and found.share == pytest.approx(share, abs=0.05)
    assert (found.half_play or 0.0) == pytest.approx(half, abs=0.0012)


def test_play_without_evidence_is_unknown() -> None:
    rng = np.random.default_rng(0)
    nothing = np.zeros(500)
    found = identified(rng.uniform(-0.02, 0.02, 500), nothing, nothing, rng.normal(0.0, 0.3, 500), 300.0, 0.0)
    assert found.half_play is None


@given(seeds)
@examples(30)
def test_noise_keeps_the_nominal_drive(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, k, d = 1500, 20.0, 0.5
    ahead, error, rate_error = 0.02 * rng.normal(0.0, [[1.0], [0.1], [0.1]], (3, count))
    effort = ahead + k * error + d * rate_error + rng.normal(0.0, 0.25, count)
    found = identified(error, rate_error, ahead, effort, k, d)
    assert (found.share, found.strength, found.half_play) == (1.0, 1.0, None)


def swaying(seed: int, count: int = 1500) -> tuple[Record, dict[str, FloatArray]]:
    """Record of an arm with random links and friction, and the random values."""
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
        assert joint.damping == pytest.approx(drawn["damping"][j], abs=0.4), name
        assert joint.backlash is None and joint.effort_share == pytest.approx(0.0, abs=0.05)
        assert joint.residual < min(0.6, found.nominal_residual[name])


def test_a_nominal_arm_keeps_its_links() -> None:
    record, _ = swaying(3)
    regressor = dynamics.Regressor(MODEL, JOINTS)
    velocity, effort = record.velocity[:, PLACES], record.effort.copy()
    nominal, _ = dynamics._modelled(regressor, record, PLACES.tolist())
    effort[:, PLACES] = nominal + 2.0 * np.sign(velocity) + 0.5 * velocity
    same = Record(*(effort if name == "effort" else getattr(record, name) for name in Record.__dataclass_fields__))
    _, links = dynamics.identify(MODEL, JOINTS, same)
    for name, link in links.items():
        body = MODEL.mj.body(name).id
        assert link.mass == pytest.approx(float(MODEL.mj.body_mass[body]), rel=0.01)
        np.testing.assert_allclose(link.com, MODEL.mj.body_ipos[body], atol=0.002)


def test_too_little_motion_is_rejected() -> None:
    record, _ = swaying(0, 300)
    record.velocity[:, PLACES[2]] = 0.01
    with pytest.raises(UnidentifiedError, match=f"{ARM}: too little motion: {JOINTS[2]} moved in 0 moments of 300"):
        identify(MODEL, ARM, record, 1)


def test_poses_avoid_the_body_and_return() -> None:
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


def test_a_record_averages_periods() -> None:
    robot = RobotInProcess(ROBOT, "ideal", 0)
    recorder = Recorder(ROBOT)
    upright = np.array((1.0, 0.0, 0.0, 0.0))
    robot.each = lambda: recorder.add(robot.measured, robot.motor, upright)
    robot.run(0.1)
    record = recorder.record()
    assert len(record.time) == 10 and np.diff(record.time) == pytest.approx(0.01)
    neck = ROBOT.index["neck_yaw"]
    assert robot.motor.mode[neck] == JointMode.POSITION
    assert (record.stiffness[:, neck] == ROBOT.servo_stiffness[neck]).all()
