"""A fall that is detected, and what the joints are commanded until the robot lies."""

import mujoco
import numpy as np
import pytest

from harness.places import ROBOTS
from harness.robot_in_process import RobotInProcess
from harness.still_robot import Robot, tilted
from valor.common.behaviors import Behavior, Reaction
from valor.common.messages import DeviceStatus
from valor.comms_manager.command_arbiter import drives
from valor.motion_manager.locomotion.landing import LONGEST
from valor.robot.description import RobotDescription
from valor.robot.legs import knees

ESCHER = RobotDescription.load(ROBOTS / "escher")


@pytest.mark.parametrize("impulse", [99.0, -99.0], ids=["forward", "backward"])
def test_it_folds_its_legs_keeps_its_head_off_the_ground_and_is_limp_then(impulse: float) -> None:
    run = RobotInProcess(ESCHER, "hardware", 1)
    assert not (refused := run.stand_up()), refused
    bent, standing = knees(ESCHER), run.plant.joint_position
    run.plant.push(np.array((impulse, 0.0, 0.0)), 0.1)
    assert run.run_until(lambda: run.behavior is Behavior.FALL, 3.0)
    mj, data = run.plant.model.mj, run.plant.data
    head, force, hit, folded = run.plant.model.body("head"), np.zeros(6), 0.0, 0.0
    for _ in range(round(LONGEST / ESCHER.control_period) - 2):
        run.step()
        assert drives(run.motor), "until it lies"
        assert (run.motor.position <= ESCHER.upper).all() and (run.motor.position >= ESCHER.lower).all()
        folded = max(folded, float((bent.flexion(run.plant.joint_position) - bent.flexion(standing)).min()))
        for row in range(data.ncon):
            bodies = mj.geom_bodyid[data.contact[row].geom]
            if head in bodies and 0 in bodies:
                mujoco.mj_contactForce(mj, data, row, force)
                hit = max(hit, float(force[0]))
    assert folded > 0.5 and hit < 2000.0, "limp, its head hits the ground with 4000 N after a push from behind"
    run.run(0.1)
    assert not drives(run.motor) and run.behavior is Behavior.FALL


def falls() -> Robot:
    falling = Robot().stand()
    while falling.behavior is not Behavior.FALL:
        motor = falling.tick(imu_orientation=tilted(1.2))
    assert drives(motor)
    return falling


def test_a_requested_fall_and_a_device_that_demands_limp_joints_have_no_landing() -> None:
    for robot in (Robot().stand(), falls()):
        assert not robot.ask(Behavior.FALL)
        assert not drives(robot.tick()), "requested: limp at once"
    robot = falls()
    empty = np.zeros(0)
    hot = DeviceStatus(0, [], [], [], empty, empty, empty, empty, empty, empty, Reaction.LIMP, "too hot")
    robot.manager.components.device_reactions.receive(hot)
    assert not drives(robot.tick())


def test_freeze_ends_a_landing() -> None:
    falling = falls()
    held = falling.tick().position
    assert not falling.ask(Behavior.FREEZE)
    assert np.abs(falling.tick().position - held).max() < 0.5 and falling.behavior is Behavior.FREEZE
