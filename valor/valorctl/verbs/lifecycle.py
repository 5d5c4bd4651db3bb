"""``up``, ``down``, ``restart``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valor.common import linking
from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance, RosCommands, Settings, WhenLost
from valor.common.processes import RECORDER
from valor.common.viewing import LOOPBACK
from valor.simulation.world_names import WORLD_NAMES
from valor.valorctl import completion
from valor.valorctl.console import Progress, progress, say
from valor.valorctl.interruption import Interruption
from valor.valorctl.recording_options import BOUND_VARIABLE
from valor.valorctl.verbs.options import (
    Deployment,
    OptionalClock,
    OptionalProfile,
    OptionalRealTimeFactor,
    OptionalRobot,
)

if TYPE_CHECKING:
    from valor.valorctl.hosts.deployment import Deployment as DeploymentFile
    from valor.valorctl.instance_setup import Plan

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
WaitForVrc = Annotated[
    bool | None,
    typer.Option(
        help="In lockstep robot time waits for the Valor ROS Controller, a second at most. [default: profile's]"
    ),
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
Namespace = Annotated[
    str, typer.Option(metavar="NAME", help="Of all ROS names and the robot's frames: several robots in one domain.")
]
Domain = Annotated[
    int | None, typer.Option(min=0, max=232, help="ROS domain, to share it; without, one that nobody uses.")
]
Peers = Annotated[
    str | None,
    typer.Option(metavar="HOST,…", help="Computers that ROS 2 reaches, named or by address; '': this one alone."),
]

Foxglove = Annotated[bool, typer.Option("--foxglove", help="Let Foxglove look on, by WebSocket, at 127.0.0.1:8765.")]
FoxgloveAt = Annotated[
    str | None,
    typer.Option(metavar="[HOST:]PORT", help="The same, there; beyond this computer anybody may look."),
]
Camera = Annotated[
    bool,
    typer.Option("--camera", help="The simulated robot has a camera: ROS topic camera/image_raw/compressed."),
]
View = Annotated[bool, typer.Option("--view", help="Serve a page on which the robot is seen and driven.")]
ViewHost = Annotated[str | None, typer.Option(metavar="ADDRESS", help="The same, there; beyond this computer by TLS.")]
ViewCertificate = Annotated[
    Path | None, typer.Option(metavar="FILE", help="PEM, certificate and key; a self-made one unless given.")
]
Link = Annotated[
    str | None,
    typer.Option(metavar="DOMAIN[:PORT]", help="The operator's ROS domain, behind a link; PORT: what stands between."),
]
Lost = Annotated[WhenLost, typer.Option(help="With --link: what a robot does that walks, 10 s without the operator.")]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(up)
    app.command()(down)
    app.command()(restart)


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
    camera: Camera = False,
    view: View = False,
    view_host: ViewHost = None,
    view_certificate: ViewCertificate = None,
    link: Link = None,
    when_lost: Lost = "go_on",
    namespace: Namespace = "",
    domain: Domain = None,
    peers: Peers = None,
) -> None:
    """Start a system; returns when every process is ready and the robot is in its initial mode."""
    from valor.valorctl import instance_setup, recording_options, startup, viewing

    instance = Instance.from_environment()
    began = time.monotonic()
    hosts, here = _deployed(instance, deployment, profile, peers)
    view = view or view_host is not None or view_certificate is not None
    shown_at = viewing.place(view_host or LOOPBACK, view_certificate) if view else None
    request = instance_setup.Request(
        profile=hosts.profile if hosts else profile or "sim", deployment=hosts, here=here, robot=robot,
        clock=clock, actuators=actuators, seed=seed, world=world, real_time_factor=rtf,
        wait_for_vrc=wait_for_vrc, bag=bag, bag_bound=tuple(bag_bound or ()), no_bag=no_bag,
        recording=recording_options.recording(bag_only or (), bag_without or (), bag_split or (), bag_ring),
        initial_mode=initial_mode, ros_commands=ros_commands, foxglove=foxglove_at or ("" if foxglove else None),
        camera=camera, view=shown_at, link=linking.parsed(link, when_lost), ros_domain=domain, namespace=namespace,
        peers=None if peers is None else tuple(filter(None, peers.split(","))),
    )  # fmt: skip
    plan = instance_setup.plan(request)
    with progress() as shown, Interruption() as interruption:
        if hosts is not None:
            from valor.valorctl.hosts import together

            settings = together.bring_up(instance, plan, here, shown, interruption)
        else:
            settings = startup.bring_up(instance, plan, shown, interruption)
    _announce(instance, plan, settings, time.monotonic() - began)


def _deployed(
    instance: Instance, name: str | None, profile: str | None, peers: str | None
) -> tuple[DeploymentFile | None, str]:
    """The deployment asked for, if any, and which of its hosts this computer is."""
    if name is None:
        return None, ""
    if profile is not None or peers is not None:
        raise ConfigurationError("--deployment: expected without --profile and --peers, which its file says")
    from valor.valorctl.hosts import together

    return together.deployed(instance, name)


def _announce(instance: Instance, plan: Plan, settings: Settings, seconds: float) -> None:
    """What is up, and where to look at it."""
    from valor.valorctl import foxglove_options, recording_report, viewing

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
    if plan.viewing is not None:
        say(viewing.announcement(instance))
    if linking.robots_hosts(settings):
        from valor.valorctl.hosts.beyond import there

        say(f"the operator's side; the robot's is another `up`; {there(settings)}")
    if (told := foxglove_options.announcement(settings)) is not None:
        say(told)


def down(deployment: Deployment = None) -> None:
    """Stop a system and remove all it leaves but logs and bags. What is not up stays down: that is no error."""
    from valor.valorctl import instance_setup, recording_report, shutdown

    instance = Instance.from_environment()
    if deployment is not None or (instance.settings_file.exists() and instance.settings().hosts):
        _down_everywhere(instance, deployment)
        return
    since = recording_report.up_since(instance)
    with progress() as shown, Interruption(), instance_setup.changing(instance):
        shown.waiting(f"stopping instance {instance.name!r}")
        was_up = shutdown.take_down(instance)
    say(f"instance {instance.name!r} is down" if was_up else f"instance {instance.name!r} was not up")
    for written in since():
        say(written.line())


def _down_everywhere(instance: Instance, name: str | None) -> None:
    """On all hosts: of the deployment, else of the instance that is up."""
    from valor.valorctl.hosts import together

    settings = instance.settings() if name is None else together.settings_of(instance, name)
    near = settings.beside(settings.here)
    with progress() as shown, Interruption() as interruption:
        beyond = _down_beyond(instance, settings, shown, interruption)
        shown.waiting(f"stopping instance {instance.name!r} on {', '.join(host.name for host in near)}")
        was_up, problems = together.take_down(instance, settings)
    if beyond:
        over = "\n".join(problems) or "this side is down"
        raise ValorError(f"{beyond}\nwhat runs on the robot's side goes on; {over}")
    if problems:
        again = f"once it is back: valorctl down --deployment FILE{Instance.option(instance.name)}"
        raise ValorError("\n".join([*problems, f"what runs there goes on; all other hosts are down; {again}"]))
    where = "every host" if len(near) == len(settings.hosts) else ", ".join(host.name for host in near)
    say(f"instance {instance.name!r} is down on {where}" if was_up else f"instance {instance.name!r} was not up")


def _down_beyond(instance: Instance, settings: Settings, shown: Progress, interruption: Interruption) -> str:
    """First the robot's side, where this is the operator's; why that is not down, empty: it is, or there is none."""
    robots = linking.robots_hosts(settings)
    if not robots:
        return ""
    from valor.valorctl.hosts.beyond import Beyond, BeyondError, there

    if not instance.settings_file.exists():
        shown.done(f"the robot's side is not reached while this one is not up; {there(settings)}")
        return ""
    shown.waiting(f"stopping instance {instance.name!r} on {', '.join(robots)}, through the link")
    try:
        with Beyond(instance, instance.settings(), interruption.check) as beyond:
            beyond.down(lambda said: shown.done(f"robot's side: {said}"))
    except BeyondError as error:
        return str(error)
    return ""


def restart(
    service: Annotated[
        str, typer.Argument(help="One of those that `status` lists.", autocompletion=completion.services)
    ],
) -> None:
    """Stop a process, start it anew, and wait until it is ready."""
    from valor.valorctl import startup

    instance = Instance.from_environment()
    settings = instance.settings()
    with progress() as shown, Interruption() as interruption:
        if linking.beyond(settings, service):
            from valor.valorctl.hosts.beyond import Beyond

            shown.waiting(f"restarting {service}, through the link")
            with Beyond(instance, settings, interruption.check) as beyond:
                shown.done(beyond.do("restart", service))
        else:
            startup.restart(instance, service, shown, interruption)
