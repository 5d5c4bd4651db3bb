"""``up``, ``down``, ``restart``, ``host resume``, and ``host order``, which other hosts call."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valor.bags import recordings
from valor.common import linking
from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance, RosCommands, Settings, WhenLost
from valor.common.processes import RECORDER, VIEW
from valor.simulation.world_names import WORLD_NAMES
from valor.valorctl.recordings.recording_options import BOUND_VARIABLE
from valor.valorctl.terminal import completion
from valor.valorctl.terminal.console import Interruption, progress, say
from valor.valorctl.terminal.options import (
    Deployment,
    OptionalClock,
    OptionalProfile,
    OptionalRealTimeFactor,
    OptionalRobot,
)

if TYPE_CHECKING:
    from valor.valorctl.hosts.deployment import Deployment as DeploymentFile
    from valor.valorctl.instance.instance_setup import Plan

Actuators = Annotated[
    str | None,
    typer.Option(help="Actuator profile of robot.yaml, such as ideal, hardware.", autocompletion=completion.actuators),
]
Seed = Annotated[int | None, typer.Option(min=0, help="Seed of all random numbers of the simulation.")]
World = Annotated[
    str | None, typer.Option(help=f"Simulated world: {', '.join(WORLD_NAMES)}.", autocompletion=completion.worlds)
]
Bag = Annotated[Path | None, typer.Option(help="File (.mcap) or new folder of the recording.")]
NoBag = Annotated[bool, typer.Option("--no-bag", help="Record nothing.")]
BagBound = Annotated[
    list[str] | None,
    typer.Option(
        metavar="SIZE|AGE|SHARE",
        envvar=BOUND_VARIABLE,
        help="Bound of all recordings of the instance; the oldest are removed: 20GB, 30d, 10% of the disk, or none.",
    ),
]
BagOnly = Annotated[
    list[str] | None, typer.Option(metavar="PATTERN", help="Record only topics like '/bifrost/*'; repeatable.")
]
BagWithout = Annotated[
    list[str] | None, typer.Option(metavar="PATTERN", help="Do not record topics like '*/statistics'; repeatable.")
]
BagSplit = Annotated[
    list[str] | None,
    typer.Option(metavar="SIZE|TIME", help="Start a new bag every 500MB, 60s or 10min. [default: 4GB]"),
]
BagRing = Annotated[
    float | None,
    typer.Option(metavar="S", help="Hold only the last S seconds; a fall or `bag snap` saves them. [s]"),
]
WaitForVrc = Annotated[
    bool | None,
    typer.Option(help="In lockstep, robot time waits up to 1 s for the Valor ROS Controller. [default: profile's]"),
]
InitialMode = Annotated[
    str | None,
    typer.Option(
        help="Control mode after the start: stand_prep, stand, stand_manipulate; '' for none. [default: profile's]",
        autocompletion=completion.initial_modes,
    ),
]
Commands = Annotated[
    RosCommands, typer.Option(help="Sources of commands that ROS 2 accepts; none: only valorctl commands the robot.")
]
Namespace = Annotated[
    str, typer.Option(metavar="NAME", help="Namespace of all ROS names and frames, for several robots in one domain.")
]
Domain = Annotated[
    int | None, typer.Option(min=0, max=232, help="ROS domain, possibly shared. [default: an unused one]")
]
Peers = Annotated[
    str | None,
    typer.Option(metavar="HOST,…", help="Computers that ROS 2 communicates with, by name or address; '' for none."),
]
Foxglove = Annotated[bool, typer.Option("--foxglove", help="Serve Foxglove by WebSocket at 127.0.0.1:8765.")]
FoxgloveAt = Annotated[
    str | None,
    typer.Option(metavar="[HOST:]PORT", help="Serve Foxglove there; any computer that reaches HOST can read."),
]
Sensors = Annotated[
    str, typer.Option(metavar="NAME,…", help="Add sensors to the simulated robot: lidar, camera (docs/sensors.md).")
]
View = Annotated[bool, typer.Option("--view", help="Serve the operator's page.")]
Link = Annotated[
    str | None,
    typer.Option(
        metavar="DOMAIN[:PORT][@RATE]",
        help="The operator's ROS domain behind a link; PORT: of a UDP relay; RATE: of the slow channel [B/s].",
    ),
]
Lost = Annotated[
    WhenLost,
    typer.Option(
        "--on-operator-lost", help="With --link: reaction of a walking robot after 10 s without the operator."
    ),
]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    for verb in (up, down, restart, reset):
        app.command()(verb)
    group = typer.Typer(no_args_is_help=True, help="This computer as one of several hosts (docs/deployment.md).")
    group.command()(resume)
    group.command(hidden=True)(order)
    app.add_typer(group, name="host")


def up(
    *,
    profile: OptionalProfile = None,
    deployment: Deployment = None,
    robot: OptionalRobot = None,
    clock: OptionalClock = None,
    actuators: Actuators = None,
    seed: Seed = None,
    world: World = None,
    rtf: OptionalRealTimeFactor = None,
    wait_for_vrc: WaitForVrc = None,
    bag: Bag = None,
    no_bag: NoBag = False,
    bag_bound: BagBound = None,
    bag_only: BagOnly = None,
    bag_without: BagWithout = None,
    bag_split: BagSplit = None,
    bag_ring: BagRing = None,
    initial_mode: InitialMode = None,
    ros_commands: Commands = "all",
    foxglove: Foxglove = False,
    foxglove_at: FoxgloveAt = None,
    sensors: Sensors = "",
    view: View = False,
    link: Link = None,
    when_lost: Lost = "go_on",
    namespace: Namespace = "",
    domain: Domain = None,
    peers: Peers = None,
) -> None:
    """Start a system. Return when all processes are ready and the robot is in its initial mode."""
    from valor.valorctl.instance import instance_setup, startup
    from valor.valorctl.recordings import recording_options

    instance = Instance.from_environment()
    began = time.monotonic()
    hosts, here = _deployed(deployment, profile, peers)
    request = instance_setup.Request(
        profile=hosts.profile if hosts else profile or "sim", deployment=hosts, here=here, robot=robot,
        clock=clock, actuators=actuators, seed=seed, world=world, real_time_factor=rtf,
        wait_for_vrc=wait_for_vrc, bag=bag, bag_bound=tuple(bag_bound or ()), no_bag=no_bag,
        recording=recording_options.recording(bag_only or (), bag_without or (), bag_split or (), bag_ring),
        initial_mode=initial_mode, ros_commands=ros_commands, foxglove=foxglove_at or ("" if foxglove else None),
        sensors=tuple(filter(None, sensors.split(","))), view=view,
        link=linking.parsed(link, when_lost), ros_domain=domain, namespace=namespace,
        peers=None if peers is None else tuple(filter(None, peers.split(","))),
    )  # fmt: skip
    plan = instance_setup.plan(request)
    with progress() as shown, Interruption() as interruption:
        if hosts is not None:
            from valor.valorctl.hosts import multi_host

            settings = multi_host.bring_up(instance, plan, hosts, shown, interruption)
        else:
            settings = startup.bring_up(instance, plan, shown, interruption)
    _announce(instance, plan, settings, time.monotonic() - began)


def _deployed(name: str | None, profile: str | None, peers: str | None) -> tuple[DeploymentFile | None, str]:
    if name is None:
        return None, ""
    if profile is not None or peers is not None:
        raise ConfigurationError("--deployment: expected without --profile and --peers, which its file specifies")
    from valor.valorctl.hosts import multi_host

    return multi_host.deployed(name)


def _announce(instance: Instance, plan: Plan, settings: Settings, seconds: float) -> None:
    from valor.valorctl.instance import viewing
    from valor.valorctl.recordings import recording_report

    near = [host.name for host in settings.beside(settings.here)]
    say(
        f"instance {instance.name!r} is up in {seconds:.1f} s: {settings.robot.name}, "
        f"profile {settings.profile}, {settings.clock}, ROS domain {settings.ros_domain_id}"
        + (f", namespace {settings.namespace}" if settings.namespace else "")
        + (f", hosts {', '.join(near)}" if near else "")
        + (f", peers {', '.join(settings.peers)}" if settings.peers and not settings.hosts else "")
    )
    if RECORDER in (own := settings.processes_here(plan.profile.processes)) or not settings.hosts:
        say(recording_report.announcement(instance, settings, own))
    if any(process.option == VIEW for process in plan.profile.table):
        say(viewing.announcement(instance))
    if advice := linking.robot_side_advice(settings):
        say(f"the operator's side is up; the robot's has its own `up`; {advice}")
    if (where := viewing.foxglove_announcement(settings)) is not None:
        say(where)


def down(deployment: Deployment = None) -> None:
    """Stop a system. Remove its files except logs and bags; succeed if the system is not up."""
    from valor.valorctl.instance import instance_setup, shutdown
    from valor.valorctl.recordings import recording_report

    instance = Instance.from_environment()
    if deployment is not None or (instance.settings_file.exists() and instance.settings().hosts):
        _down_everywhere(instance, deployment)
        return
    bag = recordings.being_written(instance.folder)
    with progress() as shown, Interruption(), instance_setup.changing(instance):
        shown.waiting(f"stopping instance {instance.name!r}")
        was_up = shutdown.take_down(instance)
    say(f"instance {instance.name!r} is down" if was_up else f"instance {instance.name!r} was not up")
    if bag is not None and bag.exists():
        say(recording_report.summary(bag))


def _down_everywhere(instance: Instance, name: str | None) -> None:
    from valor.valorctl.hosts import multi_host

    settings = instance.settings() if name is None else multi_host.settings_of(name)
    near = settings.beside(settings.here)
    with progress() as shown, Interruption():
        shown.waiting(f"stopping instance {instance.name!r} on {', '.join(host.name for host in near)}")
        was_up, problems = multi_host.take_down(instance, settings)
    if problems:
        again = f"when it is reachable again: valorctl down --deployment FILE{Instance.option(instance.name)}"
        raise ValorError("\n".join([*problems, f"its processes keep running; all other hosts are down; {again}"]))
    where = "every host" if len(near) == len(settings.hosts) else ", ".join(host.name for host in near)
    say(f"instance {instance.name!r} is down on {where}" if was_up else f"instance {instance.name!r} was not up")
    if advice := linking.robot_side_advice(settings):
        say(f"processes on the robot's side keep running; {advice}")


def restart(
    service: Annotated[str, typer.Argument(help="A process listed by `status`.", autocompletion=completion.services)],
) -> None:
    """Restart a process. Return when it is ready."""
    from valor.valorctl.instance import startup

    instance = Instance.from_environment()
    linking.require_local(instance.settings(), service, "restart")
    with progress() as shown, Interruption() as interruption:
        startup.restart(instance, service, shown, interruption)


def reset() -> None:
    """Place the simulated robot at its start, in mode stand; robot time starts again."""
    from valor.valorctl.instance import running, startup

    instance = running.require_running()
    with progress() as shown, Interruption() as interruption:
        startup.reset(instance, shown, interruption)


def resume() -> None:
    """Start this computer's part of an instance again after a loss of power, if the other hosts still run it."""
    from valor.valorctl.hosts import orders

    say(orders.resume(Instance.from_environment()))


def order() -> None:
    """Execute an order that another host sends by ssh: one JSON line on stdin."""
    from valor.valorctl.hosts import orders

    orders.serve()
