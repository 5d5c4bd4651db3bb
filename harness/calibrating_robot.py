"""An arm calibrated in one process: as ``valorctl calibrate arm`` does it, without ROS and sockets."""

from __future__ import annotations

from harness.manipulating_robot import ManipulatingRobot
from valor.calibration.identify import Found, identify
from valor.calibration.poses import Poses
from valor.calibration.record import Recorder
from valor.common.messages import Motor
from valor.robot.model import full_model

REST = 0.3  # in a pose [s]


def calibrate(bench: ManipulatingRobot, group: str, poses: int) -> Found:
    """Bring an arm through poses and back, and find what it is; sensors and commands alone are looked at."""
    robot, parts = bench.robot, bench.manager.parts
    chooser = Poses(full_model(robot, "collision"), group, parts.reference.position)
    arm = robot.group_indices(group)
    recorder = Recorder(robot)
    motors: dict[int, Motor] = {}

    def listen() -> None:
        motors[bench.motor.sequence] = bench.motor
        acting = motors.get(bench.measured.motor_sequence)
        if acting is not None and parts.state is not None:
            recorder.add(bench.measured, acting, parts.state.pelvis_orientation_in_odom)

    bench.each = listen
    for _ in range(poses):
        bench.follow(arm, chooser.next())
        bench.run(REST)
    for goal in chooser.back(parts.reference.position[arm], poses):
        bench.follow(arm, goal)
    bench.each = None
    return identify(full_model(robot), group, recorder.record(), poses)
