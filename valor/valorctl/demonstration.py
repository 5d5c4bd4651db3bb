"""``demo``: a system of its own, a ROS client that makes the robot do something, one bag, and pictures of it."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.resources import example_file
from valor.common.robot import RobotDescription
from valor.valorctl import instance_setup, shutdown, startup
from valor.valorctl.console import Progress
from valor.valorctl.interruption import InterruptedBySignalError, Interruption

NAME = "demo"
PROGRAM = "stand_and_reach.py"
GROUPS = ("right_arm", "neck")

_PROGRAM_TIMEOUT = 300.0  # [s]


def run(instance: Instance, robot: str | None, out: Path, progress: Progress, interruption: Interruption) -> None:
    """Run the demonstration, and tell where bag, measurements and pictures are. Nothing goes on running behind it.

    Args:
        instance: of the demonstration's own.
        robot: a name of ``robots/``, or a folder; None: the profile's.
        out: the folder for what it leaves.
        progress: told how it goes on.
        interruption: ends it early.

    Raises:
        ValorError: a part of it failed; says which.
    """
    program = example_file(PROGRAM)
    bag, measurements = prepare(out, "demo.mcap", "demo.json")
    failure: ValorError | None = None
    request = instance_setup.Request(robot=robot, actuators="hardware", bag=bag)
    with running(instance, request, progress, interruption) as settings:
        try:
            _run_client(instance, program, measurements, interruption)
        except InterruptedBySignalError:
            raise
        except ValorError as error:
            failure = error  # the pictures may show why
    try:
        made = _draw(bag, RobotDescription.load(settings.robot), out, progress, interruption)
    except ValorError as error:
        raise failure or error from None
    tell([bag, measurements, *made], progress)
    if failure:
        raise failure


def prepare(out: Path, *names: str) -> list[Path]:
    """Make the folder for what a demonstration leaves, and remove what an earlier one left under these names.

    Raises:
        ValorError: the folder cannot be written.
    """
    files = [out / name for name in names]
    try:
        out.mkdir(parents=True, exist_ok=True)
        for stale in files:
            stale.unlink(missing_ok=True)
    except OSError as error:
        raise ValorError(f"{error.filename}: {error.strerror}") from None
    return files


@contextlib.contextmanager
def running(
    instance: Instance, request: instance_setup.Request, progress: Progress, interruption: Interruption
) -> Iterator[Settings]:
    """A system that is up inside and down behind, whatever happens."""
    settings = startup.bring_up(instance, instance_setup.plan(request), progress, interruption)
    try:
        yield settings
    finally:
        progress.waiting("shutting down")
        with instance_setup.changing(instance):
            shutdown.take_down(instance)
        progress.done("everything is shut down")


def tell(files: Iterable[Path], progress: Progress) -> None:
    """Say which files there are."""
    for file in files:
        progress.done(f"{file} ({file.stat().st_size / 1e6:.1f} MB)")


def _run_client(instance: Instance, program: Path, measurements: Path, interruption: Interruption) -> None:
    """Run the client as anybody's program would run: with the instance's environment and nothing else of ours."""
    # A session of its own: Ctrl-C comes to us alone, and we end it in good order.
    client = subprocess.Popen(
        [sys.executable, str(program), "--json", str(measurements)],
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


def _draw(bag: Path, robot: RobotDescription, out: Path, progress: Progress, interruption: Interruption) -> list[Path]:
    """Pictures and plots from the bag alone."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    from valor.analysis import pictures, plots
    from valor.analysis.bag import Bag

    made: list[Path] = []
    progress.waiting("drawing the robot before and after")
    recording = Bag.of(bag)
    made += pictures.render_before_after(recording, robot, out)
    interruption.check()
    progress.waiting("plotting how well the joints followed")
    made += plots.joint_tracking(recording, robot, GROUPS, out)
    interruption.check()
    return made
