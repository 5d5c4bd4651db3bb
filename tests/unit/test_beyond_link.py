"""Verbs on the operator's side of a link: what Bifrost alone carries is refused, and where it can be done is said."""

from pathlib import Path

import pytest

from harness.places import ROBOTS
from valor.common.errors import ValorError
from valor.common.instance import Host, Instance, Settings
from valor.common.linking import robots_hosts
from valor.valorctl import presence

HOSTS = (
    Host(name="motion", address="10.76.0.1"), Host(name="desk", address="10.76.0.3", operator=True),
)  # fmt: skip


def settings(here: str) -> Settings:
    """Of a deployment, as a host has them."""
    return Settings(robot=ROBOTS / "escher", ros_domain_id=70, hosts=HOSTS, here=here)


def test_the_robots_hosts_are_out_of_reach_from_the_operators_alone() -> None:
    assert robots_hosts(settings("desk")) == ("motion",)
    assert robots_hosts(settings("motion")) == ()
    assert robots_hosts(Settings(robot=ROBOTS / "escher", ros_domain_id=70)) == ()


def test_a_verb_that_the_link_does_not_carry_says_where_to_run_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VALOR_HOME", str(tmp_path))
    monkeypatch.setenv("VALOR_INSTANCE", "apart")
    made = Instance("apart", tmp_path)
    made.folder.mkdir(parents=True)
    made.settings_file.write_text(settings("desk").json())
    with pytest.raises(ValorError, match="run it on motion; from here: `mode`"):
        presence.require_running()
    with pytest.raises(ValorError, match="crashed"):
        presence.require_running(through_link=True)
