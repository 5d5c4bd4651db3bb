"""The hardware variant: real processes, real ports, emulated devices that fail; and a start that is refused."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from harness.instance import RunningInstance
from harness.places import ROBOTS
from harness.waiting import PATIENCE, some, wait_until
from tests.integration.device_system import RobotOnDevices, on_devices
from valor.common.processes import EXIT_CONFIGURATION
from valor.common.topics import GROUND_TRUTH, PROPRIOCEPTOR
from valor.robot.description import RobotDescription

UPRIGHT = 0.7  # of the pelvis: lower, it has fallen [m]


class Bench(RobotOnDevices):
    def __init__(self, running: RunningInstance) -> None:
        super().__init__(running)
        self._truth = GROUND_TRUTH.subscriber(self.node)

    def height(self) -> float:
        """Of the pelvis, in truth [m]."""
        return float(some(self._truth.receive(PATIENCE)).message.pelvis_position_in_world[2])


def test_a_start_with_another_device_is_refused(instance: RunningInstance, tmp_path: Path) -> None:
    instance.configure(variant="hardware", control_rate=250.0)
    instance.start("device_emulators", wait=True)
    other = tmp_path / "escher"
    shutil.copytree(ROBOTS / "escher", other)
    table = (other / "robot.yaml").read_text()
    (other / "robot.yaml").write_text(table.replace("FT-45-0118", "FT-45-9999"))
    instance.configure(robot=other)
    process = instance.start("comms_manager")
    assert process.wait(PATIENCE) == EXIT_CONFIGURATION
    expected = "force_torque/2: serial number 'FT-45-0118'; expected 'FT-45-9999' (robot.yaml)"
    assert expected in instance.log("comms_manager")


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with on_devices("hdt_driver", "hdt_bridge") as running:
        yield Bench(running)


@pytest.fixture
def standing(bench: Bench) -> Iterator[Bench]:
    """In Stand, with every device well; it still stands afterwards."""
    wait_until(lambda: all(state == "ok" for state in bench.status.states), PATIENCE, "every device is well")
    bench.go("stand")
    yield bench
    for device in ("legs", "force_torque", "imu"):
        bench.fail(device, "")
    assert bench.height() > UPRIGHT


def test_it_stands_on_its_devices(standing: Bench) -> None:
    wait_until(lambda: not standing.status.reason, PATIENCE, "nothing is told")  # a busy computer is late now and then
    status = standing.status
    assert {unit.split("/")[0] for unit in status.units} == {
        "force_torque",
        "imu",
        "kvh",
        "neck",
        "hdt",
        "legs",
        "batteries",
    }
    assert len([unit for unit in status.units if unit.startswith("legs/")]) == 7
    assert (status.reaction, status.reason) == ("keep_balance", "")
    measured = standing.measured()
    assert 300.0 < measured.left_foot_wrench[2] + measured.right_foot_wrench[2] < 1500.0
    assert 0.75 < standing.height() < 0.85


@pytest.mark.parametrize("fault", ["silent", "garbage"])
def test_a_hand_sensor_that_cannot_be_believed_is_named_and_balance_goes_on(standing: Bench, fault: str) -> None:
    before = standing.unit("force_torque/3")[2]
    standing.fail("force_torque/3", fault)
    wait_until(lambda: standing.unit("force_torque/3")[0] == "silent", PATIENCE, "the sensor is told to be silent")
    assert standing.behavior == "stand"
    standing.fail("force_torque", "")
    wait_until(lambda: standing.unit("force_torque/3")[0] == "ok", PATIENCE, "it is back by itself")
    assert standing.behavior == "stand"
    if fault != "silent":
        wait_until(lambda: standing.unit("force_torque/3")[2] > before, PATIENCE, "what was refused is counted")


def test_duplicates_are_refused_and_harm_nobody(standing: Bench) -> None:
    before = standing.unit("legs/3")[2]
    standing.fail("legs/3", "duplicate")
    wait_until(lambda: standing.unit("legs/3")[2] > before + 20, PATIENCE, "duplicates are counted")
    assert standing.unit("legs/3")[0] == "ok" and standing.behavior == "stand"


@pytest.mark.parametrize(
    ("unit", "fault", "words"), [("legs/1", "under_voltage", "40.0 V"), ("force_torque/1", "silent", "no valid state")]
)
def test_the_robot_comes_to_rest_until_it_is_commanded(standing: Bench, unit: str, fault: str, words: str) -> None:
    standing.fail(unit, fault)
    wait_until(lambda: standing.behavior == "soft_stop", PATIENCE, "soft stop")
    assert standing.state.reason.startswith(f"{unit}: ") and words in standing.state.reason
    assert standing.status.reaction == "soft_stop"
    standing.fail(unit.split("/", maxsplit=1)[0], "")
    wait_until(lambda: standing.status.reaction == "keep_balance", PATIENCE, "the unit is well again")
    assert standing.behavior == "soft_stop"


def test_a_leg_controller_that_is_silent_has_the_joints_held(standing: Bench) -> None:
    standing.fail("legs/7", "silent")
    wait_until(lambda: standing.behavior == "freeze", PATIENCE, "freeze")
    assert standing.state.reason.startswith("legs/7: no valid state")


def test_a_controller_that_lost_its_power_is_found_and_switched_on_again(standing: Bench) -> None:
    standing.fail("legs/7", "unplugged")
    wait_until(lambda: standing.behavior == "freeze", PATIENCE, "freeze")
    standing.fail("legs", "")
    wait_until(lambda: standing.unit("legs/7")[0] == "ok", PATIENCE, "its motors are on")
    assert "legs/7: its motors are off" in standing.running.log("comms_manager")


def test_both_imus_are_unplugged_one_after_the_other_and_plugged_in_again(standing: Bench) -> None:
    standing.fail("imu", "unplugged")
    wait_until(lambda: standing.unit("imu")[0] != "ok", PATIENCE, "the imu is missed")
    assert standing.behavior == "stand", standing.state.reason  # on its stand-by
    standing.fail("kvh", "unplugged")
    wait_until(lambda: standing.behavior == "freeze", PATIENCE, "freeze")
    assert standing.state.reason.startswith(("imu", "kvh")), standing.state.reason
    imus = ("imu", "kvh")
    for imu in imus:
        standing.fail(imu, "")
    wait_until(lambda: all(standing.unit(imu)[0] == "ok" for imu in imus), PATIENCE, "they are found again")


def test_the_comms_manager_may_die_under_a_standing_robot_and_come_back(standing: Bench) -> None:
    """Motor controllers hold their joints by themselves; whoever comes back finds a robot that stands, and lets it."""
    standing.running.kill("comms_manager")
    standing.running.start("comms_manager")
    standing.running.wait_ready("comms_manager", PATIENCE)
    wait_until(lambda: standing.behavior != "stand", PATIENCE, "the Motion Manager knows")
    assert standing.behavior == "freeze", standing.state.reason
    assert standing.state.reason.startswith("no Proprioceptor for") and "it stands" in standing.state.reason
    assert standing.height() > UPRIGHT
    standing.go("stand")


def test_the_motion_manager_may_die_under_a_standing_robot_and_no_joint_moves(standing: Bench) -> None:
    """Nor a finger's, whose servo is so soft that a noisy measurement of its effort would move it."""
    robot = RobotDescription.load(ROBOTS / "escher")
    positions = PROPRIOCEPTOR.subscriber(standing.running.node("watcher"), queue=20_000)
    first = some(positions.receive(PATIENCE))
    standing.running.kill("motion_manager")
    standing.running.start("motion_manager")
    standing.running.wait_ready("motion_manager", PATIENCE)
    wait_until(lambda: standing.behavior == "freeze", PATIENCE, "the next one holds what it finds")
    way = np.abs([each.message.joint_position - first.message.joint_position for each in positions.drain()])
    moved = np.where(np.isfinite(robot.upper), way.max(axis=0), 0.0)  # but for the lidar, which turns for ever
    assert moved.max() < 0.05, robot.joints[int(moved.argmax())]
    standing.go("stand")


def test_an_encoder_that_jumps_is_believed_no_more(standing: Bench) -> None:
    """The last one: only a restart takes it back."""
    standing.fail("legs/7", "encoder_jump")
    wait_until(lambda: standing.behavior == "freeze", PATIENCE, "freeze")
    assert "the encoder of waist_yaw jumped" in standing.state.reason
    standing.fail("legs", "")
    status = standing.status
    wait_until(lambda: standing.status is not status, PATIENCE, "another word")
    assert standing.unit("legs/7")[0] == "faulty"
