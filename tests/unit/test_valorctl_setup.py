"""What `up` prepares: supervisord's configuration, the order of start, the ROS domain, the profile, the settings."""

from __future__ import annotations

import configparser
import shlex
from collections.abc import Iterable
from pathlib import Path

import msgspec
import pytest
import yaml

from harness.places import REPOSITORY
from valor.common import resources
from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Instance, Settings
from valor.common.processes import DAEMON, EXIT_CONFIGURATION, PROCESSES, SUPERVISED, Process
from valor.robot.description import RobotDescription
from valor.valorctl import instance_setup, supervisor_config
from valor.valorctl.instance_setup import Request
from valor.valorctl.profile import Profile
from valor.valorctl.startup import free


def rendered() -> configparser.RawConfigParser:
    parser = configparser.RawConfigParser(inline_comment_prefixes=(";", "#"))
    parser.read_string(supervisor_config.render(PROCESSES))
    return parser


def test_every_row_of_the_process_table_becomes_a_program() -> None:
    parser = rendered()
    for process in PROCESSES:
        program = parser[f"program:{process.name}"]
        assert shlex.split(program["command"])[-2:] == ["-m", process.module]
        assert program["exitcodes"] == str(EXIT_CONFIGURATION)
        assert program["autorestart"] == "unexpected"
        assert program["stopasgroup"] == program["killasgroup"] == "true"
        assert int(program["stopwaitsecs"]) >= process.stop_timeout - 0.5
        assert program["redirect_stderr"] == "true"
        assert program["stdout_logfile"].endswith(f"/logs/{process.name}.log")
    assert len([name for name in parser.sections() if name.startswith("program:")]) == len(PROCESSES)


def test_supervisord_listens_on_no_network() -> None:
    assert "inet_http_server" not in rendered().sections()


def test_processes_get_one_thread_each_and_the_instance(tmp_path: Path) -> None:
    instance = Instance("x", tmp_path)
    instance.folder.mkdir()
    instance.settings_file.write_text(Settings(robot=tmp_path, ros_domain_id=7).json())
    made = supervisor_config.environment(instance, "/usr/bin/python3", {"KEPT": "1", "ROS_DOMAIN_ID": "0"})
    assert made["KEPT"] == made["OPENBLAS_NUM_THREADS"] == made["OMP_NUM_THREADS"] == "1"
    assert (made["ROS_DOMAIN_ID"], made["VALOR_INSTANCE"], made["VALOR_HOME"]) == ("7", "x", str(tmp_path))
    assert SUPERVISED in made
    assert SUPERVISED not in instance.environment()


def test_a_home_too_long_for_a_socket_is_refused_before_anything_happens(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="shorter VALOR_HOME"):
        supervisor_config.socket_file(Instance("x", tmp_path / ("d" * 100)))


def process(name: str, *after: str) -> Process:
    return Process(name, "", 1.0, 1.0, after)


def names(processes: Iterable[Process]) -> list[str]:
    return [each.name for each in processes]


def test_processes_start_as_soon_as_what_they_need_is_ready() -> None:
    table = [process("c", "b"), process(DAEMON), process("a"), process("b", "a"), process("d", "a")]
    present = names(table)
    assert names(free(table, [], present)) == [DAEMON]
    assert names(free(table, [DAEMON], present)) == [DAEMON, "a"]
    assert names(free(table, [DAEMON, "a"], present)) == [DAEMON, "a", "b", "d"]
    assert names(free(table, [DAEMON, "a", "b"], present)) == present


def test_a_process_waits_for_others_where_the_profile_has_them() -> None:
    late = process("late", "early")
    assert names(free([late], [DAEMON], ["late", "early"])) == []
    assert names(free([late], [DAEMON, "early"], ["late", "early"])) == ["late"]
    assert names(free([late], [DAEMON], ["late"])) == ["late"]


@pytest.mark.parametrize("profile", sorted(file.stem for file in (REPOSITORY / "deploy").glob("*.yaml")))
def test_every_process_of_a_profile_starts_some_time(profile: str) -> None:
    table = Profile.load(resources.profile_file(profile)).table
    present, ready = names(table), list[str]()
    while len(ready) < len(table):
        able = names(free(table, ready, present))
        assert set(able) > set(ready), f"{set(present) - set(ready)} wait for each other"
        ready = able


def test_processes_for_devices_that_the_robot_does_not_have_are_left_out() -> None:
    profile = Profile(
        description="", variant="hardware", processes=("bifrostd", "hdt_driver", "hdt_bridge", "comms_manager")
    )
    escher = RobotDescription.load(resources.robot_folder("escher"))
    assert profile.suiting(escher).processes == profile.processes
    tables = msgspec.structs.replace(escher.tables, devices={})
    assert profile.suiting(RobotDescription(escher.folder, tables)).processes == ("bifrostd", "comms_manager")


def test_the_profiles_that_come_with_us_are_valid() -> None:
    files = sorted((Path(resources.profile_file("sim"))).parent.glob("*.yaml"))
    assert [file.stem for file in files] == ["bifrost", "hardware", "motion_system", "sim"]
    daemon, hardware, motion_system, simulation = (Profile.load(file) for file in files)
    assert hardware.initial_mode == simulation.initial_mode == "stand"
    assert [p.name for p in hardware.table] == [p.name for p in PROCESSES if not p.option]
    assert {p.name for p in hardware.table} - {p.name for p in simulation.table} == {
        "device_emulators", "hdt_driver", "hdt_bridge",
    }  # fmt: skip
    assert (hardware.variant, simulation.variant) == ("hardware", "simulation")
    assert [p.name for p in motion_system.table] == ["bifrostd", "comms_manager", "motion_manager"]
    assert daemon.initial_mode is motion_system.initial_mode is None
    assert [p.name for p in daemon.table] == ["bifrostd"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"processes": ["bifrostd", "motion_master"]}, "motion_master"),
        ({"processes": ["comms_manager"]}, "comms_manager needs bifrostd"),
        ({"processes": []}, "processes"),
        ({"initial_posture": "stand"}, "initial_posture"),
        ({"defaults": {"clock": "sundial"}}, "defaults.clock"),
        ({"defaults": {"real_time_factor": -1}}, "defaults.real_time_factor"),
        ({"defaults": {"bag_bound": ["5 parsecs"]}}, "defaults.bag_bound 5 parsecs: expected a size"),
    ],
)
def test_a_wrong_profile_names_file_and_key(tmp_path: Path, change: dict[str, object], words: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump({"description": "mine", "processes": ["bifrostd"]} | change))
    with pytest.raises(ConfigurationError, match=words) as caught:
        Profile.load(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_go_before_the_profile() -> None:
    plan = instance_setup.plan(Request(clock="realtime", seed=7, real_time_factor=0.0, initial_mode=""))
    assert (plan.settings.clock, plan.settings.seed, plan.settings.real_time_factor) == ("realtime", 7, 0.0)
    assert (plan.settings.actuators, plan.settings.robot) == ("hardware", resources.robot_folder("escher"))
    assert plan.initial_mode is None


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (Request(profile="moon"), "profile 'moon'.*sim"),
        (Request(robot="atlas"), "robot 'atlas'.*escher"),
        (Request(robot="/nowhere"), "robot '/nowhere'"),
        (Request(actuators="magic"), "--actuators 'magic'.*ideal"),
        (Request(world="moon"), "--world 'moon'.*flat, dirt, stairs, stairs_15cm, rubble"),
        (Request(bag=Path("/")), "--bag"),
        (Request(bag=Path("/x.mcap"), no_bag=True), "--no-bag: expected without"),
        (Request(bag_bound=("none", "5GB")), "--bag-bound none 5GB: expected none by itself"),
    ],
)
def test_what_is_unknown_is_refused_with_the_known(request_: Request, words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        instance_setup.plan(request_)


def test_only_one_may_change_an_instance(tmp_path: Path) -> None:
    instance = Instance("x", tmp_path)
    with instance_setup.changing(instance):
        with pytest.raises(ValorError, match="another valorctl"), instance_setup.changing(instance):
            pass
        with instance_setup.changing(Instance("y", tmp_path)):
            pass
    with instance_setup.changing(instance):
        pass
