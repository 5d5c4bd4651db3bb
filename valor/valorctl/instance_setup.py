"""What an instance gets before anything runs: its folder, a Bifrost network, its settings."""

from __future__ import annotations

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
from valor.bags import recordings
from valor.common import membership, mode_names, whole_file
from valor.common.bounds import Bounds
from valor.common.document import Document
from valor.common.errors import ConfigurationError, ValorError, expected, require_one_of
from valor.common.instance import ClockMode, Instance, Link, Recording, RosCommands, Settings, ros_namespace
from valor.common.processes import (
    BY_NAME,
    CAMERA,
    FOXGLOVE,
    HEAD_CAMERA,
    LINK,
    OPERATOR_STOP,
    PROCESSES,
    RECORDER,
    VIEW,
)
from valor.common.resources import profile_file, robot_folder
from valor.common.viewing import Viewing
from valor.robot.description import RobotDescription
from valor.simulation.world_names import WORLD_NAMES
from valor.valorctl import foxglove_options, middleware, recording_options
from valor.valorctl.hosts.deployment import Deployment
from valor.valorctl.profile import Profile
from valor.valorctl.robot_check import require_sound
from valor.valorctl.ros_domain import daemon_ports

OTHERS = 0o077  # what a mode grants to anybody but the owner


@dataclass(frozen=True)
class Request:
    """What ``valorctl up`` was asked for; None: as the profile has it."""

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
    initial_mode: str | None = None  # empty: leave the robot as it starts
    ros_commands: RosCommands = "all"
    foxglove: str | None = None  # [HOST:]PORT; empty: the usual one
    camera: bool = False  # in the simulated robot's head
    view: Viewing | None = None  # serve the operator's page there
    link: Link = field(default_factory=Link)  # its domain: none, unless there is one
    ros_domain: int | None = None
    namespace: str = ""
    peers: tuple[str, ...] | None = None
    deployment: Deployment | None = None
    here: str = ""  # which of the deployment's hosts this is


@dataclass(frozen=True)
class Plan:
    """A request with the profile filled in, checked against the robot."""

    profile: Profile
    settings: Settings  # but for the ROS domain, which is chosen when the instance is made
    initial_mode: str | None
    ros_domain: int | None  # None: one that nobody uses
    viewing: Viewing | None = None  # where the operator's page is served; None: nowhere


def plan(request: Request) -> Plan:
    """Fill in the profile's defaults and check everything that can be checked before anything is written.

    Raises:
        ConfigurationError: names the file or option and what was expected.
    """
    file = profile_file(request.profile)
    profile = Profile.load(file)
    defaults = profile.defaults
    folder = _robot_folder(request, defaults.robot, file)
    # A robot that somebody is to move must be one that can stand.
    moved = {"comms_manager", "motion_manager"}.intersection(profile.processes)
    robot = (require_sound if moved else RobotDescription.load)(folder, profile.control_rate)
    _check(robot, profile, file)
    listed = profile.processes
    if request.deployment is not None:
        profile = msgspec.structs.replace(profile, processes=request.deployment.processes)
        listed = profile.processes
    profile = _with_options(profile, request)
    if HEAD_CAMERA in profile.processes and profile.variant != "simulation":
        raise ConfigurationError(f"{CAMERA}: profile {request.profile} has no simulated world; expected a real camera")
    settings = Settings(
        profile=request.profile,
        variant=profile.variant,
        robot=robot.folder,
        control_rate=profile.control_rate,
        ports=profile.ports,
        clock=request.clock or defaults.clock,
        actuators=request.actuators or defaults.actuators,
        seed=defaults.seed if request.seed is None else request.seed,
        world=request.world or defaults.world,
        real_time_factor=(defaults.real_time_factor if request.real_time_factor is None else request.real_time_factor),
        wait_for_vrc=defaults.wait_for_vrc if request.wait_for_vrc is None else request.wait_for_vrc,
        ros_domain_id=0,
        ros_commands=request.ros_commands,
        namespace=ros_namespace(request.namespace),
        peers=middleware.addresses(profile.peers if request.peers is None else request.peers),
        bag=_bag(request.bag),
        recording=msgspec.structs.replace(request.recording, bounds=_bounds(request, profile)),
        asked=tuple(name for name in profile.processes if BY_NAME[name].option),
        foxglove=foxglove_options.listening(request.foxglove or ""),
        **_hosts(request, profile, listed),
        link=request.link if request.deployment is None else request.deployment.link_settings,
    )
    if FOXGLOVE in settings.asked:
        foxglove_options.require(settings.foxglove)
    for key, known in (("actuators", robot.tables.actuators), ("world", WORLD_NAMES)):
        if getattr(request, key) is not None:
            require_one_of(f"--{key}", getattr(request, key), known)
        elif (default := getattr(defaults, key)) not in known:
            raise Document.load(file).error(("defaults", key), expected(default, known))
    initial_mode = profile.initial_mode if request.initial_mode is None else request.initial_mode
    if request.initial_mode and "valor_ros_controller" not in profile.processes:
        raise ConfigurationError(
            f"--initial-mode {request.initial_mode!r}: profile {request.profile} has no control modes"
        )
    if initial_mode:
        require_one_of("--initial-mode", initial_mode, mode_names.initial())
    return Plan(profile.suiting(robot), settings, initial_mode or None, request.ros_domain, request.view)


def _hosts(request: Request, profile: Profile, listed: Collection[str]) -> dict[str, Any]:
    """What the settings say of the hosts: with what options ask for, and without what they do not want."""
    if request.deployment is None:
        return {}
    if request.link.domain is not None:
        raise ConfigurationError("--link: both ends run on this computer; expected `link:` in --deployment's file")
    asked = {VIEW: request.view is not None, "--foxglove": request.foxglove is not None, CAMERA: request.camera}
    for host, row in request.deployment.hosts.items():
        for name in row.processes:
            if host != request.here and asked.get(BY_NAME[name].option):
                raise ConfigurationError(
                    f"{BY_NAME[name].option}: {name} runs on {host}; expected `up` there, or no option"
                )
    also = [name for name in profile.processes if name not in listed]
    but = [name for name in listed if name not in profile.processes]
    return {"deployment": request.deployment.name, "hosts": request.deployment.table(request.here, also, but)}


def _with_options(profile: Profile, request: Request) -> Profile:
    """With what options ask for, and without what they do not want."""
    if request.foxglove is not None:
        profile = profile.adding(FOXGLOVE)
    asked = {VIEW: request.view is not None, LINK: request.link.domain is not None, CAMERA: request.camera}
    at_robot = request.deployment is None or request.here not in request.deployment.operators
    for process in PROCESSES:
        stop = process.name == OPERATOR_STOP  # it speaks Bifrost with the robot: not from behind a link
        if asked.get(process.option) and not (stop and (asked[LINK] or not at_robot)):
            profile = profile.adding(process.name)
    if request.no_bag:
        _expect_no_bag_options(request)
        profile = profile.without(RECORDER)
    return profile


def _robot_folder(request: Request, default: str, file: Path) -> Path:
    if request.robot is not None:
        return robot_folder(request.robot)
    try:
        return robot_folder(default)
    except ConfigurationError as error:
        raise Document.load(file).error(("defaults", "robot"), str(error)) from None


def _check(robot: RobotDescription, profile: Profile, file: Path) -> None:
    """Profile and robot must fit each other."""
    known = [f"can{device.bus}" if hasattr(device, "bus") else name for name, device in robot.tables.devices.items()]
    for port in profile.ports:
        if port not in known:
            raise Document.load(file).error(("ports", port), expected(port, known))
    if not {"comms_manager", "motion_manager"}.intersection(profile.processes):
        return
    if profile.variant == "simulation":
        _check_period(robot, profile, file)
    elif not robot.tables.devices:
        raise robot.error(["devices"], "none; expected those of the robot, for a profile on hardware")


def _check_period(robot: RobotDescription, profile: Profile, file: Path) -> None:
    """A control period is a whole number of physics steps; else whoever says the rate is told."""
    try:
        robot.physics_steps()
    except ConfigurationError:
        if profile.control_rate is None:
            raise
        step = robot.tables.physics_step
        what = f"got {profile.control_rate:g}; expected a period that is a whole number of physics_step, {step:g} s"
        raise Document.load(file).error(["control_rate"], what) from None


def _bag(file: Path | None) -> Path | None:
    if file is None:
        return None
    file = file.expanduser().absolute()
    if file.is_dir():
        raise ConfigurationError(f"--bag {file}: is a folder; expected a file name")
    return file


def _bounds(request: Request, profile: Profile) -> Bounds:
    """The option's words go before the profile's."""
    return recording_options.bounds(request.bag_bound, recording_options.bounds(profile.defaults.bag_bound, Bounds()))


def _expect_no_bag_options(request: Request) -> None:
    if request.bag is not None or request.recording != Recording():
        raise ConfigurationError("--no-bag: expected without another option that says what is recorded, or where")


def make(
    instance: Instance,
    wanted: Settings,
    ros_domain: int,
    block: int,
    bring: Callable[[Instance], object] | None = None,
) -> Settings:
    """Make the folder, and write network, keys and settings.

    Args:
        instance: whose folder it is.
        wanted: what its settings shall be, but for the domain and the ports.
        ros_domain: its ROS domain.
        block: number of the ports that are its own.
        bring: writes network and keys that are there already; None: new ones are made.

    Raises:
        ConfigurationError: the folder cannot be written.
    """
    try:
        instance.folder.mkdir(parents=True, exist_ok=True)
        instance.logs.mkdir(exist_ok=True)
        instance.bags.mkdir(exist_ok=True)
        if wanted.bag is not None:
            wanted.bag.parent.mkdir(parents=True, exist_ok=True)
        recordings.save_bounds(instance.bags, wanted.recording.bounds)
        _make_private(instance.folder)
        _rotate_logs(instance)
        if bring is not None:
            bring(instance)
        else:
            ports, charter = daemon_ports(block), membership.charter(instance)
            bifrost.Network.create(instance.network_file, instance.keys, ports=ports, charter=charter)
        settings = msgspec.structs.replace(
            wanted, ros_domain_id=ros_domain, port_block=block, epoch=time.monotonic_ns()
        )
        if settings.peers:
            whole_file.write(instance.middleware_file, middleware.profile(settings.peers))
        for token in (instance.operator_token, instance.viewer_token):
            whole_file.write(token, secrets.token_urlsafe(9))
        whole_file.write(instance.settings_file, settings.json())
    except OSError as error:
        raise ConfigurationError(f"{error.filename or instance.folder}: {error.strerror}") from None
    return settings


def _rotate_logs(instance: Instance) -> None:
    """Begin logs anew; what the last ``up`` left goes to ``.1``."""
    for log in instance.logs.glob("*.log"):
        log.replace(log.with_name(log.name + ".1"))


def _make_private(folder: Path) -> None:
    """What there is already, of an ``up`` under another mask, its user keeps to himself, too."""
    for path in (folder, *folder.rglob("*")):
        mode = path.lstat().st_mode
        if not stat.S_ISLNK(mode) and mode & OTHERS:
            path.chmod(stat.S_IMODE(mode) & ~OTHERS)


@contextlib.contextmanager
def private_files() -> Iterator[None]:
    """Whatever is made here, and by the processes that are started here, is its user's alone: 0600, folders 0700."""
    before = os.umask(OTHERS)
    try:
        yield
    finally:
        os.umask(before)


@contextlib.contextmanager
def changing(instance: Instance) -> Iterator[None]:
    """Hold an instance while it is brought up or down. The kernel lets go of it, however the holder ends.

    Raises:
        ValorError: another valorctl is at it.
    """
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
