"""``up``, ``down``, ``restart``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from valor.common.instance import Instance, RosCommands
from valor.common.resources import profiles
from valor.simulation.world_names import WORLD_NAMES
from valor.valorctl import completion
from valor.valorctl.console import progress, say
from valor.valorctl.interruption import Interruption
from valor.valorctl.recording_options import BOUND_VARIABLE
from valor.valorctl.verbs.options import OptionalClock, OptionalRealTimeFactor, OptionalRobot

Profile = Annotated[
    str,
    typer.Option(
        help=f"Which processes, on what: {', '.join(profiles())}, or a .yaml file.", autocompletion=completion.profiles
    ),
]
Actuators = Annotated[
    str | None, typer.Option(help="A profile of robot.yaml: ideal, hardware.", autocompletion=completion.actuators)
]
Seed = Annotated[int | None, typer.Option(min=0, help="Of all that is random in the simulation.")]
World = Annotated[
    str | None,
    typer.Option(help=f"Where the robot stands: {', '.join(WORLD_NAMES)}.", autocompletion=completion.worlds),
]
Bag = Annotated[Path | None, typer.Option(help="The recorder's file, .mcap, or a new folder.")]
NoBag = Annotated[bool, typer.Option("--no-bag", help="Record nothing.")]
BagBound = Annotated[
    list[str] | None,
    typer.Option(
        metavar="SIZE|AGE|SHARE",
        envvar=BOUND_VARIABLE,
        help="Of all recordings of the instance, oldest go first: 20GB, 30d, 10% of the disk; or none.",
    ),
]
BagOnly = Annotated[
    list[str] | None, typer.Option(metavar="PATTERN", help="Record only topics like '/bifrost/*'; may be repeated.")
]
BagWithout = Annotated[
    list[str] | None, typer.Option(metavar="PATTERN", help="Leave out topics like '*/statistics'; may be repeated.")
]
BagSplit = Annotated[
    list[str] | None,
    typer.Option(metavar="SIZE|TIME", help="Begin a new bag every 500MB, 60s or 10min; without, every 4GB."),
]
BagRing = Annotated[
    float | None, typer.Option(metavar="S", help="Hold the last seconds; save them on a fall or `bag snap`.")
]
InitialMode = Annotated[
    str | None,
    typer.Option(
        help="Control mode to bring the robot to: stand_prep, stand, stand_manipulate; '' leaves it as it starts.",
        autocompletion=completion.initial_modes,
    ),
]
Commands = Annotated[
    RosCommands, typer.Option(help="Whose commands on ROS 2 are obeyed; none: valorctl commands, and ROS 2 looks on.")
]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(up)
    app.command()(down)
    app.command()(restart)


def up(
    *,
    profile: Profile = "sim",
    robot: OptionalRobot = None,
    clock: OptionalClock = None,
    actuators: Actuators = None,
    seed: Seed = None,
    world: World = None,
    rtf: OptionalRealTimeFactor = None,
    bag: Bag = None,
    no_bag: NoBag = False,
    bag_bound: BagBound = None,
    bag_only: BagOnly = None,
    bag_without: BagWithout = None,
    bag_split: BagSplit = None,
    bag_ring: BagRing = None,
    initial_mode: InitialMode = None,
    ros_commands: Commands = "all",
) -> None:
    """Start a system; returns when every process is ready and the robot is in its initial mode."""
    from valor.valorctl import instance_setup, recording_options, recording_report, startup

    instance = Instance.from_environment()
    began = time.monotonic()
    request = instance_setup.Request(
        profile=profile, robot=robot, clock=clock, actuators=actuators, seed=seed, world=world, real_time_factor=rtf,
        bag=bag, bag_bound=tuple(bag_bound or ()), no_bag=no_bag,
        recording=recording_options.recording(bag_only or (), bag_without or (), bag_split or (), bag_ring),
        initial_mode=initial_mode, ros_commands=ros_commands,
    )  # fmt: skip
    plan = instance_setup.plan(request)
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
