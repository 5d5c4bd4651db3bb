"""Cost of a unified controller: the Whole-Body Controller in the Motion Manager, then in the Valor ROS Controller.

Starts the whole system for a copy of a robot whose ``controllers`` list ``remote``, once for each rate of the Valor ROS
Controller, lets it stand under each arrangement, and prints a table computed from the stamps of Bifrost's messages:

    state       Proprioceptor sent ─► the controller begins to compute
    controller  its computation
    command     its result sent ─► Proprioceptor sent that reports the Motor of it as applied, up to a period afterwards
    loop        Proprioceptor sent ─► the same Proprioceptor
    age         of the state that a Motor was computed from, in control periods of robot time
    DCM         root mean square of its distance from the Motion Manager's reference

    .venv/bin/python -m benchmarks.unified_controller [--robot robots/escher] [--clock lockstep] [--seconds 20]
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

import bifrost
from benchmarks.live_system import SETTLING, started, valorctl
from benchmarks.tables import Columns, table
from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.topics import JOINT_COMMANDS, MOTION_STATE, MOTOR, PROPRIOCEPTOR, STATISTICS
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import REMOTE, WHOLE_BODY

VRC, MOTION = "valor_ros_controller", "motion_manager"
CONTROLLER = "balance_controller"
PATIENCE = 60.0  # [s]
REST = 5.0  # after an exchange of controllers [s of robot time]
ATTEMPTS = 20  # at an exchange, of half a second: a busy computer's commands come late
QUEUE = 100_000  # messages


@dataclass
class Row:
    """Measurements of one arrangement; times [s]."""

    arrangement: str
    state: FloatArray
    controller: FloatArray
    command: FloatArray
    loop: FloatArray
    age: FloatArray  # [control periods]
    tick: FloatArray  # of the Motion Manager
    dcm: FloatArray  # (k, 2) [m]
    dcm_reference: FloatArray  # (2,) [m]
    cpu: dict[str, float] = field(default_factory=dict)  # by process [% of a core]

    @property
    def dcm_error(self) -> float:
        """[m]."""
        return float(np.sqrt(np.mean(np.sum((self.dcm - self.dcm_reference) ** 2, axis=1))))


def _quantiles(of: Callable[[Row], FloatArray]) -> Callable[[Row], str]:
    return lambda row: "{:.2f}, {:.2f}".format(*np.percentile(1e3 * of(row), (50, 99)))


COLUMNS: Columns[Row] = (
    ("controller in", lambda row: row.arrangement),
    ("state", _quantiles(lambda row: row.state)),
    ("controller", _quantiles(lambda row: row.controller)),
    ("command", _quantiles(lambda row: row.command)),
    ("loop", _quantiles(lambda row: row.loop)),
    ("age", lambda row: "{:.1f}, {:.1f}".format(*np.percentile(row.age, (50, 99)))),
    ("tick of the Motion Manager", _quantiles(lambda row: row.tick)),
    ("DCM [mm]", lambda row: f"{1e3 * row.dcm_error:.2f}"),
    ("CPU [%]", lambda row: ", ".join(f"{percent:.0f}" for percent in row.cpu.values())),
    ("Motors", lambda row: str(len(row.loop))),
)


class Tap:
    """Receives all topics while the robot stands."""

    def __init__(self, node: bifrost.Node) -> None:
        self._topics = {topic: topic.subscriber(node, QUEUE) for topic in (PROPRIOCEPTOR, MOTOR, MOTION_STATE)}
        self._commands = JOINT_COMMANDS.subscriber(node, QUEUE, limited=False)
        self._statistics = {name: STATISTICS[name].subscriber(node) for name in (MOTION, VRC)}

    def measure(self, arrangement: str, seconds: float, joint: int, reference: FloatArray | None) -> Row:
        """Measure for ``seconds`` of robot time; ``joint``: one driven by force, which a command names first."""
        self._drain()
        cpu: dict[str, list[float]] = {name: [] for name in self._statistics}
        streams: list[list[bifrost.Received[Any]]] = [[], [], [], []]
        states = streams[0]
        while not states or 1e-9 * (states[-1].message.time - states[0].message.time) < seconds:
            time.sleep(0.5)
            for messages, more in zip(streams, self._drain(), strict=True):
                messages.extend(more)
            for name, subscriber in self._statistics.items():
                if received := subscriber.latest():
                    cpu[name].append(received.message.cpu_percent)
        row = _row(arrangement, streams, joint, reference)
        row.cpu = {name: float(np.mean(values)) for name, values in cpu.items()}
        return row

    def _drain(self) -> list[list[bifrost.Received[Any]]]:
        return [each.drain() for each in (*self._topics.values(), self._commands)]


def _row(
    arrangement: str, streams: Sequence[list[bifrost.Received[Any]]], joint: int, reference: FloatArray | None
) -> Row:
    """Follow each Motor back to the state that it was computed from, and on to the state that reports it."""
    states, motors, motions, commands = streams
    sent = {each.message.time: each.stamp for each in states}
    times = {each.message.sequence: each.message.time for each in states}
    made = {each.message.time: each.message for each in motions}
    remote = {float(each.message.effort[0]): each for each in commands}
    reported = np.array([each.message.motor_sequence for each in states])
    period = float(np.median(np.diff(list(sent)[:100])))
    found: list[tuple[float, ...]] = []
    for motor in motors:
        message, after = motor.message, int(np.searchsorted(reported, motor.message.sequence))
        time, output, took = message.time, motor.stamp, 0.0
        if reference is not None:  # the command in the Motor, by its torque
            command = remote.get(float(message.effort[joint]))
            if command is None:
                continue
            time, output, took = command.message.time, command.stamp, command.message.computed_in
        elif time in made:
            took = made[time].motor_time
        if time not in sent or after >= len(states) or message.proprioceptor_sequence not in times:
            continue
        applied = states[after].stamp
        age = (times[message.proprioceptor_sequence] - time) / period
        found.append((output - sent[time] - 1e9 * took, 1e9 * took, applied - output, applied - sent[time], 1e9 * age))
    if not found:
        raise ValorError(f"no Motor has a command of {arrangement}; expected one in control: is the computer too busy?")
    state, controller, command, loop, age = 1e-9 * np.array(found).T
    dcm = np.array([each.dcm_in_odom[:2] for each in made.values()])
    if reference is None:
        reference = np.mean([each.dcm_reference_in_odom[:2] for each in made.values()], axis=0)
    ticks = np.array([each.tick_time for each in made.values()])
    return Row(arrangement, state, controller, command, loop, age, ticks, dcm, reference)


def activate() -> None:
    """Activate the balance controller of the Valor ROS Controller, which begins to send commands."""
    import rclpy
    from controller_manager_msgs.srv import SwitchController

    rclpy.init()
    node = rclpy.create_node("unified_controller", enable_rosout=False, start_parameter_services=False)
    client = node.create_client(SwitchController, "/controller_manager/switch_controller")
    if not client.wait_for_service(PATIENCE):
        sys.exit(f"no controller manager within {PATIENCE:g} s")
    request = SwitchController.Request(activate_controllers=[CONTROLLER], strictness=SwitchController.Request.STRICT)
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=PATIENCE)
    reply = future.result()
    rclpy.shutdown()
    if reply is None or not reply.ok:
        sys.exit(f"{CONTROLLER} is not activated: {reply.message if reply else 'no reply'}")


@contextmanager
def vrc(instance: Instance, rate: float) -> Iterator[None]:
    """A Valor ROS Controller at a rate [Hz], in addition to a Motion System."""
    environment = os.environ | instance.environment() | {
        "VALOR_HOME": str(instance.folder.parent), "VALOR_INSTANCE": instance.name
    }  # fmt: skip
    os.environ.update(instance.environment())
    command = [sys.executable, "-m", f"valor.{VRC}", "--ros-args", "-p", f"update_rate:={rate}"]
    process = subprocess.Popen(command, env=environment)
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def measure(options: argparse.Namespace, home: Path, rate: float) -> Iterator[Row]:
    """Stand under the Motion Manager's Whole-Body Controller, then under that of the Valor ROS Controller."""
    folder = home / "robot" / options.robot.name
    if not folder.exists():
        shutil.copytree(options.robot, folder)
        with (folder / "robot.yaml").open("a") as file:
            file.write(f"\ncontrollers: {{ stand: [{WHOLE_BODY}, {REMOTE}] }}\n")
    robot = RobotDescription.load(folder)
    joint = int(robot.group_indices("left_leg")[0])
    instance = Instance(f"unified-{rate:g}", home)
    up = ("--profile", "motion_system", "--robot", str(folder), "--clock", options.clock, "--actuators", "hardware")
    with started(instance, *up) as node, vrc(instance, rate):
        tap = Tap(node)
        time.sleep(SETTLING)
        valorctl(instance, "mode", "stand")
        activate()
        tap.measure("", REST, joint, None)
        before = tap.measure(f"Motion Manager, VRC {rate:g} Hz", options.seconds, joint, None)
        yield before
        for attempt in range(ATTEMPTS):
            time.sleep(0.5)
            try:
                valorctl(instance, "controller", REMOTE)
                break
            except ValorError as error:
                print(error)
                if attempt == ATTEMPTS - 1:
                    raise
        tap.measure(f"VRC {rate:g} Hz", REST, joint, before.dcm_reference)
        yield tap.measure(f"VRC {rate:g} Hz", options.seconds, joint, before.dcm_reference)
        print(valorctl(instance, "controller"))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", type=Path, default=Path("robots/escher"), help="folder; driven by force in the legs")
    parser.add_argument("--clock", default="lockstep", choices=["realtime", "lockstep"])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rates", type=float, nargs="+", default=[250.0, 500.0], help="of the VRC [Hz]")
    options = parser.parse_args()
    load, rows = os.getloadavg()[0], list[Row]()
    with tempfile.TemporaryDirectory(prefix="valor-") as home:
        for rate in options.rates:
            try:
                rows += measure(options, Path(home), rate)
            except ValorError as error:
                sys.exit(str(error))
    console = Console(width=180)
    computer = f"load {load:.1f}, {os.cpu_count()} cores"
    title = f"{options.robot.name} stands, {options.clock}: p50, p99 [ms]; CPU of {MOTION}, {VRC}; {computer}"
    console.print(table(title, COLUMNS, rows, left=["controller in"]))


if __name__ == "__main__":
    main()
