"""A bag of messages that pass along the three pathways with known delays."""

from pathlib import Path
from typing import Any

import numpy as np

from harness.bag_file import type_store, write_bag
from thesis.analysis.pathway_taps import ARM, JOINT_STATES, MODE_COMMAND, MODE_REPORT, REFERENCE, VEC
from valor.robot.description import RobotDescription

TO_SETPOINT, TO_MOTOR, TO_STATES = 0.0012, 0.0015, 0.0008  # from a Proprioceptor sent, to what is made of it sent [s]
RESPONSE = 0.006  # from a reference to the Proprioceptor whose control values move [s]
THROUGH = 0.005  # by which Motor's positions come behind the control values [s]
FOLLOWED = 1  # control periods, from the Proprioceptor that set-points answer to the one whose Motor follows them
OBEYED = 2  # control periods, from the Proprioceptor that a Motor answers to the one that reports that it is obeyed
PLANT = 0.030  # by which joints come behind the Motor in force [s]
CYCLE, TO_DRIVER, ACTED = 5, 0.0004, 0.007  # of a driver: periods a command, delays of its messages [s]
HANDED_ON = 2  # control periods, from the first Proprioceptor after a driver's state to the one with its positions
CHANGE, REPORT = 0.012, 0.005  # of a mode [s]
MOTIONS = (1.0, 3.0)  # when one is asked for [s]
MODES = ((0.2, "stand_manipulate"), (5.2, "stand"))
END, PERIOD = 6.0, 0.002
WALL = 1_700_000_000.0
JOINT = "r_elbow_pitch"


def control_value(time: float) -> float:
    """What the VEC wants of the joint [rad]."""
    for asked in MOTIONS:
        since = (time - asked - RESPONSE) / 1.2
        if 0.0 < since < 1.0:
            return float(0.3 * np.sin(np.pi * since) ** 2 * np.sin(7.0 * since))
    return 0.0


def write(path: Path, robot: RobotDescription, *, driven: bool = False) -> None:
    """Write the bag; ``driven``: a driver has the arm."""
    store = type_store("valor_msgs", "control_msgs", "vigir_humanoid_control_msgs")
    n, column, sequence = len(robot.joints), robot.index[JOINT], 1_000_000
    rows: list[tuple[float, str, str, dict[str, Any]]] = []

    def add(at: float, topic: str, type_name: str, **fields: Any) -> None:
        rows.append((at, topic, type_name, fields))

    def stamp(at: float) -> Any:
        return store.types["builtin_interfaces/msg/Time"](sec=int(at), nanosec=round(1e9 * (at % 1.0)))

    def header(at: float) -> Any:
        return store.types["std_msgs/msg/Header"](stamp=stamp(at), frame_id="")

    def point(**fields: Any) -> Any:
        empty = {key: np.empty(0) for key in ("positions", "velocities", "accelerations", "effort")}
        last = store.types["builtin_interfaces/msg/Duration"](sec=1, nanosec=200_000_000)
        return store.types["trajectory_msgs/msg/JointTrajectoryPoint"](**(empty | {"time_from_start": last} | fields))

    def vector(value: float) -> Any:
        made = np.zeros(n)
        made[column] = value
        return made

    for k in range(round(END / PERIOD)):
        now = k * PERIOD
        behavior = "stand_manipulate" if MODES[0][0] + CHANGE <= now < MODES[1][0] + CHANGE else "stand"
        common = {"time": round(now * 1e9), "header": header(WALL + now)}
        add(now, "/bifrost/comms_manager/proprioceptor", "valor_msgs/msg/Proprioceptor", **common,
            sequence=sequence + k, motor_sequence=max(0, k + 1 - OBEYED),
            joint_position=vector(_measured(now)))  # fmt: skip
        add(now + TO_MOTOR, "/bifrost/motion_manager/motor", "valor_msgs/msg/Motor", **common, sequence=k + 1,
            proprioceptor_sequence=sequence + k, position=vector(control_value(now + TO_MOTOR - THROUGH)))  # fmt: skip
        add(now + TO_MOTOR, "/bifrost/motion_manager/motion_state", "valor_msgs/msg/MotionState", **common,
            behavior=behavior, proprioceptor_sequence=sequence + k,
            setpoint_sequence=1 + max(k - FOLLOWED, 0) // 2)  # fmt: skip
        if k % 2 == 0:
            value, speed = control_value(now), (control_value(now + 1e-5) - control_value(now)) / 1e-5
            add(now + TO_SETPOINT, "/bifrost/motion_manager/joint_setpoints", "valor_msgs/msg/JointSetpoints", **common,
                bifrost_sequence=1 + k // 2, names=[JOINT], position=np.array([value]))  # fmt: skip
            add(now + TO_STATES, JOINT_STATES, "sensor_msgs/msg/JointState", header=header(now),
                name=list(robot.joints), position=vector(0.0))  # fmt: skip
            reference = point(positions=np.array([value]), velocities=np.array([speed]))
            add(now + 0.002, VEC, "control_msgs/msg/JointTrajectoryControllerState", header=header(now),
                joint_names=[JOINT], reference=reference)  # fmt: skip
        if driven and k % CYCLE == 0:
            _drive(add, robot, k)
    for asked in MOTIONS:
        add(asked + 0.0001, REFERENCE, "trajectory_msgs/msg/JointTrajectory", joint_names=[JOINT], points=[point()])
    for at, mode in MODES:
        add(at, MODE_COMMAND, "vigir_humanoid_control_msgs/msg/VigirControlModeCommand", requested_control_mode=mode)
        add(at + CHANGE + REPORT, MODE_REPORT, "vigir_humanoid_control_msgs/msg/ControlModeStatus",
            current_control_mode=mode)  # fmt: skip
    rows.sort(key=lambda row: row[0])
    write_bag(
        path,
        store,
        ((round((WALL + at) * 1e9), topic, name, _filled(store, name, fields)) for at, topic, name, fields in rows),
    )


def _measured(now: float) -> float:
    """The joint, in the Proprioceptor sent then [rad]."""
    return control_value(now - THROUGH - OBEYED * PERIOD + TO_MOTOR - PLANT)


def _drive(add: Any, robot: RobotDescription, k: int) -> None:
    """A command to the driver that carries the Motor of a period, and the state that reports that it acted."""
    joints = robot.tables.group(ARM)
    at, count = k * PERIOD + TO_MOTOR + TO_DRIVER, 10_000_000 + k
    received = (np.ceil((at + ACTED) / PERIOD) + HANDED_ON) * PERIOD
    position = np.zeros(len(joints))
    position[joints.index(JOINT)] = control_value(k * PERIOD + TO_MOTOR - THROUGH)
    add(at, f"/bifrost/comms_manager/hdt/{ARM}/command", "valor_msgs/msg/HdtCommand", sequence=count,
        motor_sequence=k + 1, position=position)  # fmt: skip
    position = position.copy()
    position[joints.index(JOINT)] = _measured(received)
    add(at + ACTED, f"/bifrost/comms_manager/hdt/{ARM}/state", "valor_msgs/msg/HdtState", sequence=k,
        command_sequence=count, position=position)  # fmt: skip


_PLAIN = {"string": "", "bool": False, "float64": 0.0, "float32": 0.0}


def _filled(store: Any, name: str, fields: dict[str, Any]) -> Any:
    """A message of some fields, the others zero or empty."""
    content = {}
    for field, (kind, detail) in store.fielddefs[name][1]:
        if field in fields:
            content[field] = fields[field]
        elif kind.name == "BASE":
            content[field] = _PLAIN.get(detail[0], 0)
        elif kind.name == "NAME":
            content[field] = _filled(store, detail, {})
        else:
            of, length = detail
            numeric = of[0].name == "BASE" and of[1][0] != "string"
            content[field] = np.zeros(length, dtype=of[1][0] if of[1][0] != "octet" else "uint8") if numeric else []
    return store.types[name](**content)
