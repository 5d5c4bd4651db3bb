"""All that is found of an arm, as the table that the robot's folder keeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valor.calibration import dynamics, servo
from valor.calibration.dynamics import Torques
from valor.calibration.record import Record
from valor.common.errors import ValorError
from valor.robot.arm_calibration import ArmCalibration, JointCalibration, LinkCalibration
from valor.robot.description import RobotDescription
from valor.robot.model import Model

FEWEST = 200  # moments in which a joint moves
DIGITS = 5
WEAKEST, STRONGEST = 0.01, 2.0  # servo


class UnidentifiedError(ValorError):
    """The motions do not tell enough."""


@dataclass(frozen=True)
class Found:
    """An arm.

    Attributes:
        table: what the robot's folder keeps.
        nominal_residual: of each joint: torque that nominal numbers leave unexplained, RMS [N·m].
        servo_residual: likewise torque that the servo's law leaves [N·m].
        nominal_links: of each body of the table, by model.xml.
        torques: measured and explained.
    """

    table: ArmCalibration
    nominal_residual: dict[str, float]
    servo_residual: dict[str, float]
    nominal_links: dict[str, LinkCalibration]
    torques: Torques


def identify(model: Model, group: str, record: Record, poses: int) -> Found:
    """Find an arm's drives and links.

    Args:
        model: nominal, every joint in it (``full_model``).
        group: of robot.yaml, such as ``left_arm``.
        record: of its motions.
        poses: that it went through.

    Raises:
        UnidentifiedError: a joint hardly moved; names it.
    """
    robot = model.robot
    joints = tuple(robot.tables.group(group))
    for name in joints:
        moved = int((np.abs(record.velocity[:, robot.index[name]]) > dynamics.MOVING).sum())
        if moved < FEWEST:
            what = f"{name} moved in {moved} moments of {len(record.time)}; expected {FEWEST} or more"
            raise UnidentifiedError(f"{group}: not enough to go by: {what}")
    friction, bodies, torques = dynamics.identify(model, joints, record)
    servos = {name: _servo(robot, name, record) for name in joints}
    table = ArmCalibration(
        poses=poses,
        samples=len(record.time),
        joints={name: _joint(friction[name], servos[name]) for name in joints},
        links={
            name: LinkCalibration(mass=round(body.mass, DIGITS), com=[round(float(x), DIGITS) for x in body.com])
            for name, body in bodies.items()
        },
    )
    links = {
        name: LinkCalibration(mass=float(model.mj.body(name).mass[0]), com=model.mj.body(name).ipos.tolist())
        for name in bodies
    }
    nominal = {name: each.nominal_residual for name, each in friction.items()}
    return Found(table, nominal, {name: each.residual for name, each in servos.items()}, links, torques)


def _servo(robot: RobotDescription, name: str, record: Record) -> servo.Servo:
    i = robot.index[name]
    return servo.identify(
        error=record.wanted_position[:, i] - record.position[:, i],
        rate_error=record.wanted_velocity[:, i] - record.velocity[:, i],
        feed_forward=record.wanted_effort[:, i],
        stiffness=record.stiffness[:, i],
        damping=record.damping[:, i],
        effort=record.effort[:, i],
    )


def _joint(friction: dynamics.Friction, drive: servo.Servo) -> JointCalibration:
    return JointCalibration(
        friction=round(friction.coulomb, DIGITS),
        damping=round(friction.viscous, DIGITS),
        offset=round(friction.offset, DIGITS),
        backlash=None if drive.half_play is None else round(2.0 * drive.half_play, DIGITS),
        effort_share=round(drive.share, DIGITS),
        strength=round(min(max(drive.strength, WEAKEST), STRONGEST), DIGITS),
        residual=round(friction.residual, DIGITS),
    )
