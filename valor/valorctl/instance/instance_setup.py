"""Preparation of an instance: verified plan, folder, Bifrost network, settings."""

import contextlib
import fcntl
import os
import secrets
import stat
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

import bifrost
from valor.bags import retention
from valor.common import mode_names, topics, whole_file
from valor.common.document import Document
from valor.common.errors import ConfigurationError, ValorError, expected, require_one_of
from valor.common.instance import Bounds, ClockMode, Instance, Link, Recording, RosCommands, Settings, ros_namespace
from valor.common.processes import BY_NAME, FOXGLOVE, LINK, PROCESSES, RECORDER, SENSORS, VIEW
from valor.common.resources import file_of, robot_folder
from valor.robot.description import RobotDescription
from valor.simulation.world_names import WORLD_NAMES
from valor.valorctl.hosts.deployment import Deployment
from valor.valorctl.instance import viewing
from valor.valorctl.instance.profile import Profile
from valor.valorctl.instance.ros_domain import addresses, daemon_ports, peers_profile
from valor.valorctl.recordings import recording_options
from valor.valorctl.robots.robot_check import examine

OTHERS = 0o077  # permissions of other users
_DEFAULTS = ("clock", "actuators", "seed", "world", "real_time_factor", "wait_for_vrc")  # of the profile


@dataclass(frozen=True)
class Request:
    """Options of ``valorctl up``; None: as in the profile."""

    profile: str = "sim"
    robot: str | None = None
    clock: ClockMode | None = None
    actuators: str | None = None
    seed: int | None = None
    world: str | None = None
    real_time_factor: float | None = None
    wait_for_vrc: bool | None = None
    bag: Path | None = None
    bag_bound: tuple[str, ...] = ()
    no_bag: bool = False
    recording: Recording = field(default_factory=Recording)
    initial_mode: str | None = None  # empty: none
    ros_commands: RosCommands = "all"
    foxglove: str | None = None  # [HOST:]PORT; empty: the default
    sensors: tuple[str, ...] = ()  # of the simulated robot, in ``SENSORS``
    view: bool = False  # serve the operator's page
    link: Link = field(default_factory=Link)  # without a domain: no link
    ros_domain: int | None = None
    namespace: str = ""
    peers: tuple[str, ...] | None = None
    deployment: Deployment | None = None
    here: str = ""  # this computer's name in the deployment


@dataclass(frozen=True)
class Plan:
    """A request with the profile's defaults, verified against the robot."""

    profile: Profile
    settings: Settings  # without the ROS domain, which is chosen later
    initial_mode: str | None
    ros_domain: int | None  # None: an unused one


def plan(request: Request) -> Plan:
    """Add the profile's defaults to a request, and verify it; raises ``ConfigurationError``. Writes nothing."""
    for name in request.sensors:
        require_one_of("--sensors", name, SENSORS)
    file = file_of("profile", request.profile)
    profile = Profile.load(file)
    defaults = profile.defaults
    folder = _robot_folder(request, defaults.robot, file)
    # A robot that will be controlled must be able to stand.
    moved = {"comms_manager", "motion_manager"}.intersection(profile.processes)
    rate = profile.control_rate
    robot = examine(folder, rate).require_none() if moved else RobotDescription.load(folder, rate)
    _check(robot, profile, file)
    if request.deployment is not None:
        profile = msgspec.structs.replace(profile, processes=request.deployment.processes)
    listed = profile.processes
    profile = _with_options(profile, request)
    _require_sensors(profile, request, robot)
    # The option has precedence over the profile.
    bounds = recording_options.bounds(defaults.bag_bound, Bounds())
    bounds = recording_options.bounds(request.bag_bound, bounds)
    settings = Settings(
        profile=request.profile,
        variant=profile.variant,
        robot=robot.folder,
        control_rate=profile.control_rate,
        ports=profile.ports,
        **{name: getattr(defaults if getattr(request, name) is None else request, name) for name in _DEFAULTS},
        ros_domain_id=0,
        ros_commands=request.ros_commands,
        namespace=ros_namespace(request.namespace),
        peers=addresses(profile.peers if request.peers is None else request.peers),
        bag=_bag(request),
        recording=msgspec.structs.replace(request.recording, bounds=bounds),
        asked=tuple(name for name in profile.processes if BY_NAME[name].option),
        foxglove=viewing.foxglove_address(request.foxglove or ""),
        **_hosts(request, profile, listed),
        link=request.link if request.deployment is None else request.deployment.link_settings,
    )
    if FOXGLOVE in settings.asked:
        viewing.require_foxglove(settings.foxglove)
    for key, known in (("actuators", robot.tables.actuators), ("world", WORLD_NAMES)):
        if getattr(request, key) is not None:
            require_one_of(f"--{key}", getattr(request, key), known)
        elif (default := getattr(defaults, key)) not in known:
            raise Document.load(file).error(("defaults", key), expected(default, known))
    initial_mode = profile.initial_mode if request.initial_mode is None else request.initial_mode
    if request.initial_mode and "valor_ros_controller" not in profile.processes:
        what = f"profile {request.profile} has no control modes"
        raise ConfigurationError(f"--initial-mode {request.initial_mode!r}: {what}")
    if initial_mode:
        require_one_of("--initial-mode", initial_mode, mode_names.initial())
    return Plan(profile.suiting(robot), settings, initial_mode or None, request.ros_domain)


def _hosts(request: Request, profile: Profile, listed: Collection[str]) -> dict[str, Any]:
    if request.deployment is None:
        return {}
    if request.link.domain is not None:
        raise ConfigurationError("--link: both ends run on this computer; expected `link:` in --deployment's file")
    asked = _asked(request)
    for host, row in request.deployment.hosts.items():
        for name in row.processes:
            if host != request.here and (option := BY_NAME[name].option) in asked:
                raise ConfigurationError(f"{option}: {name} runs on {host}; expected `up` there, or no option")
    also = [name for name in profile.processes if name not in listed]
    but = [name for name in listed if name not in profile.processes]
    return {
        "deployment": request.deployment.name,
        "hosts": request.deployment.table(request.here, also, but),
        "here": request.here,
        "ssh": request.deployment.ssh,
    }


def _with_options(profile: Profile, request: Request) -> Profile:
    asked = _asked(request)
    names = [*profile.processes, *(process.name for process in PROCESSES if process.option in asked)]
    chosen = dict.fromkeys(name for name in names if not (request.no_bag and name == RECORDER))
    return msgspec.structs.replace(profile, processes=tuple(chosen))


def _asked(request: Request) -> set[str]:
    """Options of processes."""
    asked = {VIEW: request.view, LINK: request.link.domain is not None}
    asked |= {BY_NAME[FOXGLOVE].option: request.foxglove is not None}
    asked |= {BY_NAME[SENSORS[name].process].option: True for name in request.sensors}
    return {option for option, present in asked.items() if present}


def _require_sensors(profile: Profile, request: Request, robot: RobotDescription) -> None:
    """Raise ConfigurationError for a simulated sensor without a simulation, or that the robot lacks."""
    for name, sensor in SENSORS.items():
        if sensor.process not in profile.processes:
            continue
        what = ""
        if profile.variant != "simulation":
            what = f"profile {request.profile} has no simulated world; expected a real sensor"
        elif getattr(robot.tables, name) is None:
            what = f"{robot.name} has none; expected `{name}` in its robot.yaml"
        if what:
            raise ConfigurationError(f"{BY_NAME[sensor.process].option}: {what}")


def _robot_folder(request: Request, default: str, file: Path) -> Path:
    if request.robot is not None:
        return robot_folder(request.robot)
    try:
        return robot_folder(default)
    except ConfigurationError as error:
        raise Document.load(file).error(("defaults", "robot"), str(error)) from None


def _check(robot: RobotDescription, profile: Profile, file: Path) -> None:
    known = [f"can{device.bus}" if hasattr(device, "bus") else name for name, device in robot.tables.devices.items()]
    for port in profile.ports:
        if port not in known:
            raise Document.load(file).error(("ports", port), expected(port, known))
    if not {"comms_manager", "motion_manager"}.intersection(profile.processes):
        return
    if profile.variant == "hardware":
        robot.require_devices()
        return
    try:
        robot.physics_steps()
    except ConfigurationError:
        if profile.control_rate is None:
            raise
        step = robot.tables.physics_step
        what = f"got {profile.control_rate:g}; expected a period that is a multiple of physics_step, {step:g} s"
        raise Document.load(file).error(["control_rate"], what) from None


def _bag(request: Request) -> Path | None:
    if request.no_bag and (request.bag is not None or request.recording != Recording()):
        raise ConfigurationError("--no-bag: expected without another option about the recording")
    file = request.bag and request.bag.expanduser().absolute()
    if file is not None and file.is_dir():
        raise ConfigurationError(f"--bag {file}: is a folder; expected a file name")
    return file


def make(
    instance: Instance,
    wanted: Settings,
    ros_domain: int,
    block: int,
    bring: Callable[[Instance], object] | None = None,
) -> Settings:
    """Create the folder, and write network, keys and settings; ``bring`` writes existing network and keys.

    ``wanted``: settings without domain and ports; ``block``: number of the block of ports.
    """
    try:
        instance.folder.mkdir(parents=True, exist_ok=True)
        instance.logs.mkdir(exist_ok=True)
        instance.bags.mkdir(exist_ok=True)
        if wanted.bag is not None:
            wanted.bag.parent.mkdir(parents=True, exist_ok=True)
        retention.save_bounds(instance.bags, wanted.recording.bounds)
        _make_private(instance.folder)
        for log in instance.logs.glob("*.log"):  # of the last ``up``
            log.replace(log.with_name(log.name + ".1"))
        if bring is not None:
            bring(instance)
        else:
            ports, policy = daemon_ports(block), topics.access_policy(instance)
            bifrost.Network.create(instance.network_file, instance.keys, ports=ports, policy=policy)
        settings = msgspec.structs.replace(
            wanted, ros_domain_id=ros_domain, port_block=block, epoch=time.monotonic_ns()
        )
        if settings.peers:
            whole_file.write(instance.middleware_file, peers_profile(settings.peers))
        whole_file.write(instance.operator_token, secrets.token_urlsafe(9))
        whole_file.write(instance.settings_file, settings.json())
    except OSError as error:
        raise ConfigurationError(f"{error.filename or instance.folder}: {error.strerror}") from None
    return settings


def _make_private(folder: Path) -> None:
    """Remove other users' permissions from files of an earlier ``up`` under another mask."""
    for path in (folder, *folder.rglob("*")):
        mode = path.lstat().st_mode
        if not stat.S_ISLNK(mode) and mode & OTHERS:
            path.chmod(stat.S_IMODE(mode) & ~OTHERS)


@contextlib.contextmanager
def private_files() -> Iterator[None]:
    """A context in which this process and its children create files with mode 0600, folders with 0700."""
    before = os.umask(OTHERS)
    try:
        yield
    finally:
        os.umask(before)


@contextlib.contextmanager
def changing(instance: Instance) -> Iterator[None]:
    """Lock an instance while it is brought up or down; raises ``ValorError`` if another valorctl holds the lock."""
    file = instance.folder.parent / f".{instance.name}.lock"
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise ConfigurationError(f"{file}: {error.strerror}") from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            text = f"instance {instance.name!r} is being brought up or down by another valorctl"
            raise ValorError(text) from None
        yield
    finally:
        os.close(descriptor)
