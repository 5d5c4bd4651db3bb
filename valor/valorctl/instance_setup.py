"""What an instance gets before anything runs: its folder, a Bifrost network, its settings."""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

import bifrost
from valor.bags import recordings
from valor.common import membership, whole_file
from valor.common.bounds import Bounds
from valor.common.document import Document
from valor.common.errors import ConfigurationError, ValorError, expected, require_one_of
from valor.common.instance import ClockMode, Instance, Recording, RosCommands, Settings
from valor.common.processes import RECORDER
from valor.common.resources import profile_file, robot_folder
from valor.robot.description import RobotDescription
from valor.simulation.world_names import WORLD_NAMES
from valor.valorctl import mode_names, recording_options
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
    bag: Path | None = None
    bag_bound: tuple[str, ...] = ()
    no_bag: bool = False
    recording: Recording = field(default_factory=Recording)
    initial_mode: str | None = None  # empty: leave the robot as it starts
    ros_commands: RosCommands = "all"


@dataclass(frozen=True)
class Plan:
    """A request with the profile filled in, checked against the robot."""

    profile: Profile
    settings: Settings  # but for the ROS domain, which is chosen when the instance is made
    initial_mode: str | None


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
        ros_domain_id=0,
        ros_commands=request.ros_commands,
        bag=_bag(request.bag),
        recording=msgspec.structs.replace(request.recording, bounds=_bounds(request, profile)),
    )
    for key, known in (("actuators", robot.tables.actuators), ("world", WORLD_NAMES)):
        if getattr(request, key) is not None:
            require_one_of(f"--{key}", getattr(request, key), known)
        elif (default := getattr(defaults, key)) not in known:
            raise Document.load(file).error(("defaults", key), expected(default, known))
    if request.no_bag:
        _expect_no_bag_options(request)
        profile = profile.without(RECORDER)
    initial_mode = profile.initial_mode if request.initial_mode is None else request.initial_mode
    if request.initial_mode and "valor_ros_controller" not in profile.processes:
        raise ConfigurationError(
            f"--initial-mode {request.initial_mode!r}: profile {request.profile} has no control modes"
        )
    if initial_mode:
        require_one_of("--initial-mode", initial_mode, mode_names.initial())
    return Plan(profile.suiting(robot), settings, initial_mode or None)


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


def make(instance: Instance, wanted: Settings, ros_domain: int) -> Settings:
    """Make the folder, and write network, keys and settings.

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
        bifrost.Network.create(
            instance.network_file, instance.keys, ports=daemon_ports(ros_domain), charter=membership.charter(instance)
        )
        settings = msgspec.structs.replace(wanted, ros_domain_id=ros_domain, epoch=time.monotonic_ns())
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
