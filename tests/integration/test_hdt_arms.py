"""HDT arms of a standing robot: device ↔ Bifrost ↔ bridge ↔ ROS ↔ vendor's driver ↔ emulated modules."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from harness.places import ROBOTS
from harness.waiting import PATIENCE, wait_until
from tests.integration.device_system import RobotOnDevices, on_devices
from valor.common.arrays import FloatArray
from valor.common.topics import HDT_STATES, PROPRIOCEPTOR
from valor.comms_manager.hardware.hdt import SPEED
from valor.robot.description import RobotDescription

JUMP = 0.08  # more between two states than the joint's velocity explains [rad]; noise and play are less
ROBOT = RobotDescription.load(ROBOTS / "escher")
LIMBS = ("left_arm", "right_arm", "left_hand", "right_hand")


class Movement:
    """Movement of a limb from now on, as its driver reports it, or as the Comms Manager has it."""

    def __init__(self, bench: RobotOnDevices, limb: str, *, measured: bool = False) -> None:
        self._indices = ROBOT.group_indices(limb)
        self._states = HDT_STATES[limb].subscriber(bench.node, queue=5000)
        self._measured = PROPRIOCEPTOR.subscriber(bench.node, queue=20_000) if measured else None
        self._samples: list[tuple[float, FloatArray]] = []

    @property
    def samples(self) -> list[tuple[float, FloatArray]]:
        """Times [s] and positions [rad] so far, without those of a limb with faults."""
        if self._measured is not None:
            messages = [each.message for each in self._measured.drain()]
            self._samples += [(1e-9 * each.time, each.joint_position[self._indices]) for each in messages]
        else:
            states = [each.message for each in self._states.drain()]
            self._samples += [(1e-9 * state.time, state.position) for state in states if not state.fault.any()]
        return self._samples

    @property
    def largest_step(self) -> float:
        """Largest movement of a joint between two samples [rad], beyond its velocity limit."""
        times, positions = zip(*self.samples, strict=True)
        steps = np.abs(np.diff(positions, axis=0))
        return float((steps - np.maximum(0.01, np.diff(times))[:, None] * ROBOT.velocity_limit[self._indices]).max())


def well(bench: RobotOnDevices) -> bool:
    """Whether every limb is ready."""
    return all(bench.unit(f"hdt/{limb}")[0] == "ok" for limb in LIMBS)


def position(bench: RobotOnDevices, joint: str) -> float:
    """Measured position of a joint [rad]."""
    return float(bench.measured().joint_position[ROBOT.index[joint]])


@pytest.fixture(scope="module")
def started() -> Iterator[RobotOnDevices]:
    with on_devices("hdt_driver", "hdt_bridge", actuators="hardware") as running:
        yield RobotOnDevices(running)


@pytest.fixture
def bench(started: RobotOnDevices) -> Iterator[RobotOnDevices]:
    """The robot in Stand Manipulate, its limbs well; it still balances afterwards."""
    wait_until(lambda: well(started), PATIENCE, "every limb is ready")
    if started.behavior != "stand_manipulate":
        started.go("stand")
        started.go("stand_manipulate")
    yield started
    started.fail("hdt", "")
    assert started.behavior == "stand_manipulate", started.state.reason


def test_arms_and_hands_follow(bench: RobotOnDevices) -> None:
    at = {joint: position(bench, joint) for joint in ("l_elbow_pitch", "r_index_yaw")}
    bench.lead({joint: value + 0.4 for joint, value in at.items()})
    bench.lead(at)


@pytest.mark.parametrize(
    ("process", "reason"), [("hdt_bridge", "hdt_bridge is not running"), ("hdt_driver", "does not publish")]
)
def test_driver_and_bridge_die_and_come_back_without_a_jump(bench: RobotOnDevices, process: str, reason: str) -> None:
    before = position(bench, "l_elbow_pitch")
    bench.running.kill(process)

    def reported() -> bool:
        units = [bench.unit(f"hdt/{limb}") for limb in LIMBS]
        return all(unit[0] == "silent" and reason in unit[1] for unit in units)

    wait_until(reported, PATIENCE, f"all limbs are silent: {reason}")
    bench.lead({"l_elbow_pitch": before + 0.5}, lambda: True)
    path = Movement(bench, "left_arm", measured=True)
    assert abs(position(bench, "l_elbow_pitch") - before) < 0.1, "the arm held"
    bench.running.start(process)
    bench.lead({"l_elbow_pitch": before + 0.5})
    took = path.samples[-1][0] - path.samples[0][0]
    assert len(path.samples) > 20 and path.largest_step < JUMP
    assert took > 0.8 * 0.4 / SPEED, f"0.5 rad in {took:.2f} s"
    bench.lead({"l_elbow_pitch": before})


def test_a_silent_module_is_named_and_the_others_continue(bench: RobotOnDevices) -> None:
    at = {joint: position(bench, joint) for joint in ("r_wrist_yaw", "r_elbow_pitch")}
    bench.fail("hdt/r_wrist_yaw", "silent")
    wait_until(lambda: "r_wrist_yaw: no response" in bench.unit("hdt/right_arm")[1], PATIENCE, "the module")
    assert [limb for limb in LIMBS if bench.unit(f"hdt/{limb}")[0] != "ok"] == ["right_arm"]
    held = position(bench, "r_wrist_yaw")
    goal = {joint: value + 0.3 for joint, value in at.items()}
    bench.lead(goal, lambda: abs(position(bench, "r_elbow_pitch") - goal["r_elbow_pitch"]) < 0.1)
    assert abs(position(bench, "r_wrist_yaw") - held) < 0.02
    path = Movement(bench, "right_arm")
    bench.fail("hdt", "")
    bench.lead(goal)
    wait_until(lambda: len(path.samples) > 20, PATIENCE, "states of the arm")
    assert path.largest_step < JUMP, "without a jump"
    bench.lead(at)


def test_a_limb_that_is_unplugged_is_found_where_it_hangs(bench: RobotOnDevices) -> None:
    at = position(bench, "l_shoulder_roll")
    bench.lead({"l_shoulder_roll": at + 0.5})  # so that it falls when it is limp
    bench.fail("hdt/left_arm", "unplugged", duration=1.5)
    wait_until(lambda: bench.unit("hdt/left_arm")[0] == "unplugged", PATIENCE, "the limb is unplugged")
    assert bench.unit("hdt/right_arm")[0] == "ok"
    path = Movement(bench, "left_arm")
    wait_until(lambda: well(bench), PATIENCE, "it is plugged in again")
    assert at + 0.5 - position(bench, "l_shoulder_roll") > 0.05, "it was limp"
    bench.lead({"l_shoulder_roll": at + 0.5})
    wait_until(lambda: len(path.samples) > 20, PATIENCE, "states of the arm")
    assert path.largest_step < JUMP, "not torn back"
    bench.lead({"l_shoulder_roll": at})


def test_another_limb_than_robot_yaml_specifies_is_rejected_by_name(bench: RobotOnDevices, tmp_path: Path) -> None:
    folder = tmp_path / "escher"
    shutil.copytree(ROBOTS / "escher", folder)
    text = (folder / "robot.yaml").read_text()
    assert "HDT-A-0032" in text
    (folder / "robot.yaml").write_text(text.replace("HDT-A-0032", "HDT-A-0099"))
    bench.running.stop("hdt_driver")
    bench.running.configure(robot=folder)
    try:
        process = bench.running.start("hdt_driver")
        status, log = process.wait(PATIENCE), bench.running.log("hdt_driver")
        assert status == os.EX_CONFIG, log
        expected = "hdt/right_arm: serial 'HDT-A-0032'; expected 'HDT-A-0099' (robot.yaml)"
        assert expected in log.splitlines()[-1]
    finally:
        bench.running.configure(robot=ROBOTS / "escher")
        bench.running.kill("hdt_driver")
        bench.running.start("hdt_driver")
