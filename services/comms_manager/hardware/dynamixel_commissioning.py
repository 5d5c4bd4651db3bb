"""What is asked of a Dynamixel servo before it is used, and how it is switched on; none moves.

All functions raise ``DynamixelError`` when the servo does not do as it must, ``DeviceError`` when it is not as
robot.yaml has it, and ``serial.SerialException`` when the port is gone.
"""

from __future__ import annotations

from valor.comms_manager.hardware.condition import require_identity
from valor.comms_manager.hardware.device import DeviceError
from valor.comms_manager.hardware.dynamixel_port import DynamixelPort
from valor.comms_manager.hardware.dynamixel_servo import Servo
from valor.devices.dynamixel import MODELS, HardwareError, OperatingMode
from valor.robot.tables import RobotTables


def identify(port: DynamixelPort, servo: Servo) -> None:
    """See that it is the model of robot.yaml, with its firmware."""
    number, firmware = port.ping(servo.table.id)
    if number != servo.model.number:
        known = next((name for name, model in MODELS.items() if model.number == number), f"number {number}")
        require_identity(servo.name, {"model": known}, {"model": servo.table.model})
    require_identity(servo.name, {"firmware": firmware}, {"firmware": servo.table.firmware})


def prepare(port: DynamixelPort, servo: Servo) -> None:
    """See that nothing is wrong with it, and that it is in the mode that it is used in."""
    number, registers = servo.table.id, servo.registers
    if wrong := HardwareError(port.read(number, registers.hardware_error)):
        raise DeviceError(f"{servo.name}: {_named(wrong)}; expected no hardware error")
    mode = OperatingMode.VELOCITY if servo.spins else OperatingMode.POSITION
    servo.torque = is_on(port, servo)
    if port.read(number, registers.operating_mode) != mode:
        port.write(number, registers.torque_enable, 0)
        port.write(number, registers.operating_mode, mode)
        servo.torque = False


def check_place(port: DynamixelPort, servo: Servo, tables: RobotTables) -> None:
    """See that one that has not been switched on since it got power is in the calibration pose."""
    calibration, joint = tables.calibration, servo.table.joint
    position = servo.angle(port.read(servo.table.id, servo.registers.present_position))
    expected = (tables.nominal_posture | calibration.pose).get(joint, 0.0)
    if not servo.spins and not servo.torque and abs(position - expected) > calibration.tolerance:
        raise DeviceError(
            f"{servo.name}: at {position:.3f} rad; expected {expected:.3f} ± {calibration.tolerance:g} in the "
            f"calibration pose (robot.yaml: zero {servo.table.zero})"
        )


def switch_on(port: DynamixelPort, servo: Servo) -> None:
    """Switch its motor on: it holds its joint where that is, or begins to spin."""
    number, registers = servo.table.id, servo.registers
    port.write(number, registers.torque_enable, 1)
    if servo.table.spin is not None:
        speed = round(servo.table.direction * servo.table.spin / servo.model.velocity_unit)
        port.write(number, registers.goal_velocity, speed)
    servo.switched_on()


def revive(port: DynamixelPort, servo: Servo) -> None:
    """Switch it on again, if it is fit for that; one that says of an error is started anew first."""
    if not servo.is_fit:
        return
    if port.read(servo.table.id, servo.registers.hardware_error):
        port.reboot(servo.table.id)
        servo.forget()
    prepare(port, servo)
    switch_on(port, servo)


def is_on(port: DynamixelPort, servo: Servo) -> bool:
    """Whether its motor is."""
    return bool(port.read(servo.table.id, servo.registers.torque_enable))


def _named(errors: HardwareError) -> str:
    return " and ".join(str(each.name).lower().replace("_", " ") for each in errors) + " error"
