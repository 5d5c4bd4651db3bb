"""``up``, ``down``, ``restart``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from valor.common.instance import ClockMode, Instance, RosCommands
from valor.common.resources import profiles, robots
from valor.simulation.world_names import WORLD_NAMES
from valor.valorctl import completion
from valor.valorctl.console import progress, say
from valor.valorctl.interruption import Interruption
from valor.valorctl.recording_options import BOUND_VARIABLE

_PROFILE = typer.Option(
    help=f"Which processes, on what: {', '.join(profiles())}, or a .yaml file.", autocompletion=completion.profiles
)
ROBOT = typer.Option(help=f"{', '.join(robots())}, or a folder with robot.yaml.", autocompletion=completion.robots)
_WORLD = typer.Option(help=f"Where the robot stands: {', '.join(WORLD_NAMES)}.", autocompletion=completion.worlds)


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(up)
    app.command()(down)
    app.command()(restart)


def up(
    *,
    profile: Annotated[str, _PROFILE] = "sim",
    robot: Annotated[str | None, ROBOT] = None,
    clock: Annotated[ClockMode | None, typer.Option(help="How simulated time runs.")] = None,
    actuators: Annotated[
        str | None,
        typer.Option(help="A profile of robot.yaml: ideal, hardware.", autocompletion=completion.actuators),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of all that is random in the simulation.")] = None,
    world: Annotated[str | None, _WORLD] = None,
    rtf: Annotated[
        float | None, typer.Option(min=0.0, help="Real-time factor that lockstep is paced to; 0: as fast as it goes.")
    ] = None,
    bag: Annotated[Path | None, typer.Option(help="The recorder's file, .mcap, or a new folder.")] = None,
    no_bag: Annotated[bool, typer.Option("--no-bag", help="Record nothing.")] = False,
    bag_bound: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SIZE|AGE|SHARE",
            envvar=BOUND_VARIABLE,
            help="Of all recordings of the instance, oldest go first: 20GB, 30d, 10% of the disk; or none.",
        ),
    ] = None,
    bag_only: Annotated[
        list[str] | None, typer.Option(metavar="PATTERN", help="Record only topics like '/bifrost/*'; may be repeated.")
    ] = None,
    bag_without: Annotated[
        list[str] | None, typer.Option(metavar="PATTERN", help="Leave out topics like '*/statistics'; may be repeated.")
    ] = None,
    bag_split: Annotated[
        list[str] | None,
        typer.Option(metavar="SIZE|TIME", help="Begin a new bag every 500MB, 60s or 10min; without, every 4GB."),
    ] = None,
    bag_ring: Annotated[
        float | None, typer.Option(metavar="S", help="Hold the last seconds; save them on a fall or `bag snap`.")
    ] = None,
    initial_mode: Annotated[
        str | None,
        typer.Option(
            help="Control mode to bring the robot to: stand_prep, stand, stand_manipulate; '' leaves it as it starts.",
            autocompletion=completion.initial_modes,
        ),
    ] = None,
    ros_commands: Annotated[
        RosCommands,
        typer.Option(help="Whose commands on ROS 2 are obeyed; none: valorctl commands, and ROS 2 looks on."),
    ] = "all",
) -> None:
    """Start a system; returns when every process is ready and the robot is in its initial mode."""
    from valor.valorctl import instance_setup, recording_options, recording_report, startup

    instance = Instance.from_environment()
    recording = recording_options.recording(bag_only or (), bag_without or (), bag_split or (), bag_ring)
    began = time.monotonic()
    plan = instance_setup.plan(
        instance_setup.Request(
            profile,
            robot,
            clock,
            actuators,
            seed,
            world,
            rtf,
            bag,
            tuple(bag_bound or ()),
            no_bag,
            recording,
            initial_mode,
            ros_commands,
        )
    )
    with progress() as shown, Interruption() as interruption:
        settings = startup.bring_up(instance, plan, shown, interruption)
    say(
        f"instance {instance.name!r} is up in {time.monotonic() - began:.1f} s: {settings.robot.name}, "
        f"profile {settings.profile}, {settings.clock}, ROS domain {settings.ros_domain_id}"
    )
    say(recording_report.announcement(instance, settings, plan.profile.processes))


def down() -> None:
    """Stop a system and remove all it leaves but logs and bags. What is not up stays down: that is no error."""
    from valor.valorctl import instance_setup, recording_report, shutdown

    instance = Instance.from_environment()
    since = recording_report.up_since(instance)
    with progress() as shown, Interruption(), instance_setup.changing(instance):
        shown.waiting(f"stopping instance {instance.name!r}")
        was_up = shutdown.take_down(instance)
    say(f"instance {instance.name!r} is down" if was_up else f"instance {instance.name!r} was not up")
    for written in since():
        say(written.line())


def restart(
    service: Annotated[
        str, typer.Argument(help="One of those that `status` lists.", autocompletion=completion.services)
    ],
) -> None:
    """Stop a process, start it anew, and wait until it is ready."""
    from valor.valorctl import startup

    instance = Instance.from_environment()
    with progress() as shown, Interruption() as interruption:
        startup.restart(instance, service, shown, interruption)
