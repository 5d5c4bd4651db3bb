"""Verbs on the operator's side of a link name the host on which to run them."""

from pathlib import Path

import pytest

from harness.places import ROBOTS
from valor.common.errors import ConfigurationError, ValorError
from valor.common.instance import Host, Instance, Settings
from valor.common.linking import require_local, robot_side_advice, robots_hosts
from valor.valorctl.instance import running

HOSTS = (
    Host(name="motion", address="10.76.0.1", processes=("comms_manager",)),
    Host(name="desk", address="10.76.0.3", processes=("link_operator",), operator=True),
)


def settings(here: str) -> Settings:
    """Of a deployment, as a host has them."""
    return Settings(robot=ROBOTS / "escher", ros_domain_id=70, hosts=HOSTS, here=here)


def test_only_operator_hosts_are_separated_from_the_robots_hosts() -> None:
    assert robots_hosts(settings("desk")) == ("motion",) and robots_hosts(settings("motion")) == ()
    assert robots_hosts(Settings(robot=ROBOTS / "escher", ros_domain_id=70)) == ()
    assert "motion, by ssh" in robot_side_advice(settings("desk")) and robot_side_advice(settings("motion")) == ""


def test_a_verb_for_a_process_of_the_robots_side_names_the_ssh_command() -> None:
    with pytest.raises(ConfigurationError, match="`ssh motion valorctl restart comms_manager`"):
        require_local(settings("desk"), "comms_manager", "restart")
    require_local(settings("desk"), "link_operator", "restart")
    require_local(settings("motion"), "comms_manager", "restart")


def test_a_verb_for_the_robot_names_its_hosts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    monkeypatch.setenv("VALOR_INSTANCE", "apart")
    made = Instance("apart", tmp_path)
    made.folder.mkdir(parents=True)
    made.settings_file.write_text(settings("desk").json())
    with pytest.raises(ValorError, match="run the verb on motion, by ssh"):
        running.require_running()
