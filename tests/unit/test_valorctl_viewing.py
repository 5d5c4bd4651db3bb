"""Where the operator's page is served: what is taken, what is refused, what is told."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from msgspec import structs

from valor.common.errors import ConfigurationError
from valor.common.instance import Host, Instance, Link
from valor.common.linking import behind
from valor.common.viewing import Viewing, is_loopback
from valor.door.certificate import fingerprint, self_made
from valor.valorctl import instance_setup, viewing
from valor.valorctl.instance_setup import Request


def test_behind_a_link_the_stop_goes_through_it() -> None:
    for domain, stop in ((None, True), (77, False)):
        request = Request(view=Viewing(), link=Link(domain=domain))
        plan = instance_setup.plan(request)
        assert "operator_station" in plan.profile.processes
        assert ("operator_stop" in plan.profile.processes) is stop
        names = [process.name for process in viewing.processes(plan.settings)]
        assert ("operator_stop" in names) is stop and "operator_station" in names
    hosts = (Host(name="motion", address="10.0.0.1"), Host(name="desk", address="10.0.0.2", operator=True))
    linked = structs.replace(plan.settings, hosts=hosts)
    assert behind(structs.replace(linked, here="desk"))
    assert not behind(structs.replace(linked, here="motion")), "on the robot's side the page is as without a link"


@pytest.fixture
def instance(tmp_path: Path) -> Instance:
    made = Instance("seen", tmp_path)
    made.folder.mkdir()
    return made


def test_what_is_not_decided_is_on_the_loopback_interface(instance: Instance) -> None:
    assert Viewing.of(instance) == Viewing()
    assert not Viewing.of(instance).secured
    instance.viewing_file.write_text('{"host": 7}')
    with pytest.raises(ConfigurationError, match=r"viewing\.json"):
        Viewing.of(instance)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "127.0.0.9"])
def test_loopback_takes_no_certificate(host: str, tmp_path: Path) -> None:
    assert is_loopback(host)
    assert viewing.place(host, None) == Viewing()
    with pytest.raises(ConfigurationError, match="expected no certificate"):
        viewing.place(host, tmp_path / "mine.pem")


def test_beyond_it_there_is_a_certificate_of_our_own_or_the_one_that_is_given(
    instance: Instance, tmp_path: Path
) -> None:
    viewing.decide(instance, viewing.place("0.0.0.0", None))
    decided = Viewing.of(instance)
    assert decided.secured
    assert decided.certificate == tmp_path / "viewing.pem"
    assert stat.S_IMODE(decided.certificate.stat().st_mode) == 0o600
    first = fingerprint(decided.certificate)
    viewing.decide(instance, viewing.place("0.0.0.0", None))
    assert fingerprint(tmp_path / "viewing.pem") == first, "people have compared it"
    mine = tmp_path / "mine.pem"
    self_made(mine, "robot.lab")
    viewing.decide(instance, viewing.place("0.0.0.0", mine))
    assert Viewing.of(instance).certificate == mine
    assert Viewing.of(instance).url(8080).startswith("https://")
    assert "0.0.0.0" not in Viewing.of(instance).url(8080)


def test_what_cannot_be_served_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="expected an address of this computer"):
        viewing.place("192.0.2.1", None)
    for content in ("", "nonsense"):
        (tmp_path / "bad.pem").write_text(content)
        with pytest.raises(ConfigurationError, match=r"bad\.pem: .*expected a PEM file"):
            viewing.place("0.0.0.0", tmp_path / "bad.pem")
    with pytest.raises(ConfigurationError, match=r"none\.pem: No such file"):
        viewing.place("0.0.0.0", tmp_path / "none.pem")
