"""``demo``: the robot stands, a ROS client makes it reach, it walks onto the dirt; one bag, and pictures."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.resources import example_file
from valor.robot.description import RobotDescription
from valor.valorctl import arm_motion, demonstration, instance_setup, startup, walking
from valor.valorctl.console import Progress
from valor.valorctl.interruption import Interruption

NAME = "demo"
PROGRAM = "stand_and_reach.py"
DISTANCE = 3.0  # off the level pad, onto the dirt [m]
GROUP = "right_arm"  # that reaches
POSTURES = {"forward": "forward", "aside": "side"}  # of the client → presets

_PROGRAM_TIMEOUT = 300.0  # [s]


@dataclass(frozen=True)
class Wanted:
    """Who is to show itself, and how time runs meanwhile."""

    robot: str | None  # a name of ``robots/``, or a folder; None: the profile's
    real_time_factor: float
    video: Path | None  # where its film goes; None: none is made


def run(instance: Instance, wanted: Wanted, out: Path, progress: Progress, interruption: Interruption) -> None:
    """Run the demonstration, and tell where bag, measurements and pictures are. Nothing goes on running behind it.

    Args:
        instance: of the demonstration's own.
        wanted: whose, and how.
        out: the folder for what it leaves.
        progress: told how it goes on.
        interruption: ends it early.

    Raises:
        ValorError: a part of it failed; says which.
    """
    demonstration.require_film(wanted.video)
    program = example_file(PROGRAM)
    robot = RobotDescription.load(instance_setup.plan(instance_setup.Request(robot=wanted.robot)).settings.robot)
    arm_motion.require_limbs(robot, "demo (`demo walk` walks alone)", GROUP)
    bag, measurements = demonstration.prepare(instance, out, "demo.mcap", "demo.json")
    request = instance_setup.Request(
        robot=wanted.robot, actuators="hardware", world=demonstration.WORLD,
        real_time_factor=wanted.real_time_factor, bag=bag,
    )  # fmt: skip
    order = walking.Order(forward=demonstration.speed(robot), distance=DISTANCE, straight=True)
    failures = demonstration.Failures()
    with startup.running(instance, request, progress, interruption) as settings, failures.kept():
        _run_client(instance, [program, "--json", measurements, *_told(robot, out)], interruption)
        demonstration.walk(instance, order, progress, interruption)
    made = demonstration.draw(_drawings(bag, settings.robot, out), failures, progress, interruption)
    demonstration.tell([bag, measurements, *made], progress)
    demonstration.film(bag, wanted.video, failures, progress)
    failures.tell()
    demonstration.suggest(
        ("demo walk", f"the whole course, {demonstration.course():.0f} m"),
        ("up", "a robot of your own, that stands until `down`"),
        ("walk --vx 0.3 --for 10", "and walks"),
    )


def _drawings(bag: Path, robot_folder: Path, out: Path) -> list[demonstration.Drawing]:
    from valor.analysis import pictures, plots, walk_plots
    from valor.analysis.bag import Bag

    recording, robot = Bag.of(bag), RobotDescription.load(robot_folder)
    return [
        ("the robot before and after reaching", lambda: pictures.render_before_after(recording, robot, out)),
        ("the robot on its way", lambda: walk_plots.picture(recording, robot, out)),
        ("how well the arm followed", lambda: plots.joint_tracking(recording, robot, (GROUP,), out)),
        ("how well it kept its balance", lambda: walk_plots.dynamics(recording, robot, out)),
    ]


def _told(robot: RobotDescription, out: Path) -> list[str | Path]:
    """What the client reaches for where the names of an arm's joints do not say it: presets of the robot's."""
    presets = robot.tables.arm_presets
    postures = {told: presets[name]["right"] for told, name in POSTURES.items() if "right" in presets.get(name, {})}
    if len(postures) < len(POSTURES):
        return []
    file = out / "demo_postures.json"
    file.write_text(json.dumps(postures, indent=2) + "\n")
    return ["--postures", file]


def _run_client(instance: Instance, words: list[str | Path], interruption: Interruption) -> None:
    """Run the client as anybody's program would run: with the instance's environment and nothing else of ours."""
    program = Path(words[0])
    # A session of its own: Ctrl-C comes to us alone, and we end it in good order.
    client = subprocess.Popen(
        [sys.executable, *map(str, words)],
        env=os.environ | instance.environment(),
        start_new_session=True,
    )
    deadline = time.monotonic() + _PROGRAM_TIMEOUT
    try:
        while client.poll() is None:
            interruption.check()
            if time.monotonic() > deadline:
                raise ValorError(f"{program.name} did not end within {_PROGRAM_TIMEOUT:g} s")
            time.sleep(0.05)
    finally:
        if client.poll() is None:
            client.terminate()
            try:
                client.wait(5.0)
            except subprocess.TimeoutExpired:
                client.kill()
                client.wait()
    if client.returncode:
        raise ValorError(f"{program.name} failed with exit status {client.returncode}")
