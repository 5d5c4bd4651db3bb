"""Bytes of the makers' manuals against SI values: drivers read them, emulators send them.

Sources: e-manual of ROBOTIS (protocol 2.0, examples of its instructions; control tables); MicroStrain's "3DM-GX4-25
Data Communications Protocol"; messages of a KVH 1750 recorded by the TREC laboratory (ros_kvh1750, test/utest.cpp).
"""

from __future__ import annotations

import math
from pathlib import Path
from struct import pack

import numpy as np
import pytest

from harness.places import ROBOTS
from tests.unit.test_imus import altered
from valor.common.instance import Instance, Settings
from valor.comms_manager.hardware import dynamixel_servo, microstrain
from valor.comms_manager.hardware.device import Device, DeviceContext, make_device
from valor.comms_manager.hardware.dynamixel_port import Answer
from valor.device_emulators.dynamixel import DynamixelBus, Servo
from valor.device_emulators.kvh import KvhSensor
from valor.device_emulators.microstrain import MipSensor
from valor.devices.dynamixel import MODELS, DynamixelServo
from valor.robot.description import RobotDescription

ESCHER = RobotDescription.load(ROBOTS / "escher")
RPM = 2 * math.pi / 60

SERVOS = {
    # Model: number, first address of the feedback, steps of a turn, unit of velocity [rpm], raw effort, effort [N·m].
    "MX-28": (30, 120, 4096, 0.229, -250, -0.25 * 2.5),  # Present Load [0.1 %] of 2.5 N·m
    "MX-64": (311, 120, 4096, 0.229, -250, -0.84 * 6.0 / 4.1),  # Present Current [3.36 mA]; 6.0 N·m at 4.1 A
    "MX-106": (321, 120, 4096, 0.229, -250, -0.84 * 8.4 / 5.2),
    "XM430-W350": (1020, 120, 4096, 0.229, 100, 0.269 * 4.1 / 2.3),  # [2.69 mA]
    "XM430-W210": (1030, 120, 4096, 0.229, 100, 0.269 * 3.0 / 2.3),
    "XM540-W270": (1120, 120, 4096, 0.229, 100, 0.269 * 10.6 / 4.4),
    "XM540-W150": (1130, 120, 4096, 0.229, 100, 0.269 * 7.3 / 4.4),
    "PH54-200-S500-R": (2020, 568, 1003846, 0.01, 2000, 2.0 * 44.7 / 9.3),  # [1 mA]
    "PH54-100-S500-R": (2010, 568, 1003846, 0.01, 2000, 2.0 * 25.3 / 5.5),
    "PH42-020-S300-R": (2000, 568, 607500, 0.01, 700, 0.7 * 5.1 / 1.5),
}


def device(name: str) -> Device:
    robot = altered(name)
    return make_device(name, DeviceContext(Instance("x", Path()), Settings(robot=robot.folder, ros_domain_id=1), robot))


@pytest.mark.parametrize("model", SERVOS)
def test_feedback_of_a_servo_is_as_in_its_control_table(model: str) -> None:
    """Tick, moving, moving status, PWM, effort, velocity, position, two trajectories, voltage, temperature."""
    number, start, turn, rpm, raw, effort = SERVOS[model]
    block = pack("<HBBhhiiiiHB", 12345, 0, 0, 0, raw, -40, turn // 4, 0, 0, 121, 35)
    emulated = Servo(1, MODELS[model], 46)
    emulated.voltage, emulated.temperature = 12.1, 35.0
    emulated.measure(turn // 4, -40 * rpm * RPM, effort, 12.345)
    assert emulated.read(start, len(block)) == block and emulated.read(0, 2) == number.to_bytes(2, "little")
    table = DynamixelServo(id=1, joint="neck_yaw", model=model, firmware=46, zero=0, direction=-1)
    servo = dynamixel_servo.Servo(table, "neck", 0, ESCHER)
    assert servo.registers.feedback == (start, len(block), False)
    assert servo.process(Answer(block, 0, False), 1, must_be_on=False)
    found = (servo.position, servo.velocity, servo.effort, servo.record.voltage, servo.record.temperature)
    np.testing.assert_allclose(
        found, (-math.pi / 2, 40 * rpm * RPM, -effort, 12.1, 35.0), rtol=1e-9, atol=2 * math.pi / turn
    )


def test_a_load_is_at_most_all_of_it() -> None:
    emulated = Servo(1, MODELS["MX-28"], 46)
    emulated.measure(0, 0.0, 7.0, 0.0)
    assert emulated.read(126, 2) == (1000).to_bytes(2, "little")


@pytest.mark.parametrize(("instruction", "status"), [
    ("FF FF FD 00 01 03 00 01 19 4E", "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),  # ping: model 1030, firmware 38
    ("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15", "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),  # position 166
    ("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89", "FF FF FD 00 01 04 00 55 00 A1 0C"),  # goal 512
    ("FF FF FD 00 01 03 00 08 2F 4E", "FF FF FD 00 01 04 00 55 00 A1 0C"),  # reboot
])  # fmt: skip
def test_an_emulated_servo_answers_the_e_manuals_examples(instruction: str, status: str) -> None:
    servo = Servo(1, MODELS["XM430-W210"], 38)
    servo.measure(166.0, 0.0, 0.0, 0.0)
    (found,) = DynamixelBus([servo]).receive(bytes.fromhex(instruction))
    assert found.frame == bytes.fromhex(status)


@pytest.mark.parametrize(("descriptor", "data", "command", "reply"), [
    (0x01, "", "7565 0102 0201 E0C6", "7565 0104 04F1 0100 D56A"),  # ping
    (0x02, "", "7565 0102 0202 E1C7", "7565 0104 04F1 0200 D66C"),  # set to idle
    (0x06, "", "7565 0102 0206 E5CB", "7565 0104 04F1 0600 DA74"),  # resume
])  # fmt: skip
def test_commands_of_a_microstrain_are_the_manuals(descriptor: int, data: str, command: str, reply: str) -> None:
    assert microstrain.encode(0x01, [(descriptor, bytes.fromhex(data))]) == bytes.fromhex(command)
    assert MipSensor("3DM-GX4-25", "6234.1", "1.1.26").receive(bytes.fromhex(command)) == [bytes.fromhex(reply)]


def test_filter_data_of_a_microstrain_is_as_in_the_manual() -> None:
    """Level and turning to the left at 0.5 rad/s: the sensor, z down, turns by -0.5 and feels -1 g."""
    fields = (
        b"\x14\x03" + pack(">ffffH", 1, 0, 0, 0, 1)  # attitude quaternion
        + b"\x10\x0e" + pack(">fffH", 0, 0, -0.5, 1)  # compensated angular rate [rad/s]
        + b"\x10\x1c" + pack(">fffH", 0, 0, -9.80665, 1)  # compensated acceleration [m/s²]
        + b"\x08\x10" + pack(">HHH", 2, 1, 0)  # filter status: running, solution valid
        + b"\x0e\x11" + pack(">dHH", 0.0, 0, 0)  # GPS time stamp
    )  # fmt: skip
    driver, sensor = device("imu"), MipSensor("3DM-GX4-25", "6234.1", "1.1.26")
    assert isinstance(driver, microstrain.MicroStrain)
    message = b"\x75\x65\x82" + bytes((len(fields),)) + fields
    message += microstrain.checksum(message)
    assert driver._take(message) and driver.attitude is not None
    np.testing.assert_allclose(driver.attitude.orientation, (1, 0, 0, 0))
    np.testing.assert_allclose(driver.attitude.angular_velocity, (0, 0, 0.5))
    np.testing.assert_allclose(driver.attitude.linear_acceleration, (0, 0, 9.80665), rtol=1e-6)
    # Estimation filter message format, enable stream: the commands' data as in the manual.
    entries = b"".join(bytes((code, 0, 2)) for code in (0x03, 0x0E, 0x1C, 0x10, 0x11))
    for command, data in ((0x0A, b"\x01\x05" + entries), (0x11, b"\x01\x03\x01")):
        assert sensor.receive(microstrain.encode(0x0C, [(command, data)]))[0][4:8] == bytes((4, 0xF1, command, 0))
    sensor.angular_velocity = (0.0, 0.0, -0.5)
    assert sensor.stream(0.0) == [message]


RECORDED = "FE81FF55 B3D0BBE7 32193EF4 30AC19A5 BA8F78D6 3A290594 3F7ECBD4 77 68 001D ADC5F651"
"""At rest: rates below 1e-7 rad/s, -0.0010946 g, 0.0006448 g and 0.9953 g, all valid, sequence 104, 29 °C."""


def test_a_recorded_message_of_a_kvh_is_read_and_sent_alike() -> None:
    message = bytes.fromhex(RECORDED)
    driver = device("kvh")
    assert list(driver._stream.feed(message)) == [message], "its CRC"  # type: ignore[attr-defined]
    for k in range(200):  # at rest for 0.8 s: it finds its attitude
        driver._take(message[:29] + bytes(((104 + k) % 128,)) + message[30:])  # type: ignore[attr-defined]
    assert driver.attitude is not None
    np.testing.assert_allclose(driver.attitude.angular_velocity, (-9.7197e-8, 8.9204e-9, 1.2522e-9), rtol=1e-4)
    expected = np.array((-0.00109460, 0.00064477, 0.99529767)) * 9.80665
    np.testing.assert_allclose(driver.attitude.linear_acceleration, expected, rtol=1e-5)
    assert driver.records[0].temperature == 29
    sensor = KvhSensor("1750-0042")
    sensor.receive(b"=CONFIG,1\n=ROTFMT,RATE\n=CONFIG,0\n")
    sensor._sequence, sensor.temperature = 103, 29
    values = np.frombuffer(message[4:28], ">f4").astype(float)
    sensor.rotation, sensor.acceleration = values[:3], values[3:] * 9.80665
    assert sensor.stream(0.0) == [message]
