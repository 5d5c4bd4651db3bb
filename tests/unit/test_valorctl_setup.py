"""Preparation by `up`: supervisord's configuration, order of start, ROS domain, profile, settings."""

import configparser
import shlex
from collections.abc import Iterable
from pathlib import Path

import msgspec
import pytest

from harness.places import REPOSITORY
from valor.common import resources
from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Host, Instance, Link, Settings
from valor.common.linking import behind
from valor.common.processes import DAEMON, EXIT_CONFIGURATION, PROCESSES, SUPERVISED, Process
from valor.robot.description import RobotDescription
from valor.valorctl.instance import instance_setup, supervisor_config
from valor.valorctl.instance.instance_setup import Request
from valor.valorctl.instance.profile import Profile
from valor.valorctl.instance.startup import free


def test_every_row_of_the_process_table_becomes_a_program() -> None:
    parser = configparser.RawConfigParser(inline_comment_prefixes=(";", "#"))
    parser.read_string(supervisor_config.render(PROCESSES))
    for process in PROCESSES:
        program = parser[f"program:{process.name}"]
        assert shlex.split(program["command"])[-2:] == ["-m", process.module]
        assert program["exitcodes"] == str(EXIT_CONFIGURATION) and program["autorestart"] == "unexpected"
        assert program["stopasgroup"] == program["killasgroup"] == "true"
        assert int(program["stopwaitsecs"]) >= process.stop_timeout - 0.5
    assert "inet_http_server" not in parser.sections()  # listens on no network
    assert len([name for name in parser.sections() if name.startswith("program:")]) == len(PROCESSES)


def test_processes_get_one_thread_each_and_the_instance(tmp_path: Path) -> None:
    instance = Instance("x", tmp_path)
    instance.folder.mkdir()
    instance.settings_file.write_text(Settings(robot=tmp_path, ros_domain_id=7).json())
    made = supervisor_config.environment(instance, "/usr/bin/python3", {"KEPT": "1", "ROS_DOMAIN_ID": "0"})
    assert made["KEPT"] == made["OPENBLAS_NUM_THREADS"] == made["OMP_NUM_THREADS"] == "1"
    assert (made["ROS_DOMAIN_ID"], made["VALOR_INSTANCE"], made["VALOR_HOME"]) == ("7", "x", str(tmp_path))
    assert SUPERVISED in made and SUPERVISED not in instance.environment()


def test_a_home_too_long_for_a_socket_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="shorter VALOR_HOME"):
        supervisor_config.socket_file(Instance("x", tmp_path / ("d" * 100)))


def process(name: str, *after: str) -> Process:
    return Process(name, "", 1.0, 1.0, after)


def names(processes: Iterable[Process]) -> list[str]:
    return [each.name for each in processes]


def test_processes_start_after_those_they_need() -> None:
    table = [process("c", "b"), process(DAEMON), process("a"), process("b", "a"), process("d", "a")]
    present = names(table)
    assert names(free(table, [], present)) == [DAEMON] and names(free(table, [DAEMON], present)) == [DAEMON, "a"]
    assert names(free(table, [DAEMON, "a"], present)) == [DAEMON, "a", "b", "d"]
    assert names(free(table, [DAEMON, "a", "b"], present)) == present
    late = process("late", "early")
    assert names(free([late], [DAEMON], ["late", "early"])) == []
    assert names(free([late], [DAEMON, "early"], ["late", "early"])) == ["late"]
    assert names(free([late], [DAEMON], ["late"])) == ["late"]


@pytest.mark.parametrize("profile", sorted(file.stem for file in (REPOSITORY / "deploy").glob("*.yaml")))
def test_every_process_of_a_profile_can_start(profile: str) -> None:
    table = Profile.load(resources.file_of("profile", profile)).table
    present, ready = names(table), list[str]()
    while len(ready) < len(table):
        able = names(free(table, ready, present))
        assert set(able) > set(ready), f"{set(present) - set(ready)} wait for each other"
        ready = able


def test_processes_of_absent_devices_are_omitted() -> None:
    profile = Profile(
        description="", variant="hardware", processes=("bifrostd", "hdt_driver", "hdt_bridge", "comms_manager")
    )
    escher = RobotDescription.load(resources.robot_folder("escher"))
    assert profile.suiting(escher).processes == profile.processes
    tables = msgspec.structs.replace(escher.tables, devices={})
    assert profile.suiting(RobotDescription(escher.folder, tables)).processes == ("bifrostd", "comms_manager")


def test_options_have_precedence_over_the_profile() -> None:
    plan = instance_setup.plan(Request(clock="realtime", seed=7, real_time_factor=0.0, initial_mode=""))
    assert (plan.settings.clock, plan.settings.seed, plan.settings.real_time_factor) == ("realtime", 7, 0.0)
    assert (plan.settings.actuators, plan.settings.robot) == ("hardware", resources.robot_folder("escher"))
    assert plan.initial_mode is None


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (Request(profile="moon"), "profile 'moon'.*sim"),
        (Request(robot="atlas"), "robot 'atlas'.*escher"),
        (Request(actuators="magic"), "--actuators 'magic'.*ideal"),
        (Request(world="moon"), "--world 'moon'.*flat, dirt, stairs, stairs_15cm, rubble"),
        (Request(bag=Path("/")), "--bag"),
        (Request(bag=Path("/x.mcap"), no_bag=True), "--no-bag: expected without"),
        (Request(bag_bound=("none", "5GB")), "--bag-bound none 5GB: expected none by itself"),
    ],
)
def test_unknown_names_are_rejected_with_the_valid_ones(request_: Request, words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        instance_setup.plan(request_)


def test_one_process_at_a_time_changes_an_instance(tmp_path: Path) -> None:
    instance = Instance("x", tmp_path)
    with instance_setup.changing(instance):
        with pytest.raises(ValorError, match="another valorctl"), instance_setup.changing(instance):
            pass
        with instance_setup.changing(Instance("y", tmp_path)):
            pass
    with instance_setup.changing(instance):
        pass


def test_the_page_is_served_on_both_sides_of_a_link() -> None:
    for domain in (None, 77):
        request = Request(view=True, link=Link(domain=domain))
        plan = instance_setup.plan(request)
        assert "operator_station" in plan.profile.processes
        assert {"operator_stop", "operator_station"} <= set(plan.profile.processes)
    hosts = (Host(name="motion", address="10.0.0.1"), Host(name="desk", address="10.0.0.2", operator=True))
    linked = msgspec.structs.replace(plan.settings, hosts=hosts)
    assert behind(msgspec.structs.replace(linked, here="desk"))
    assert not behind(msgspec.structs.replace(linked, here="motion"))
