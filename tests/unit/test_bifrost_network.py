"""The network file and the keys."""

import json
import stat
from pathlib import Path
from typing import Any

import pytest

import bifrost
from valor.valorctl.instance.ros_domain import daemon_ports


@pytest.fixture
def paths(tmp_path: Path) -> tuple[Path, Path]:
    file, keys = tmp_path / "network.json", tmp_path / "keys"
    bifrost.Network.create(file, keys)
    return file, keys


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_keys_are_their_owners_alone(paths: tuple[Path, Path]) -> None:
    file, keys = paths
    assert mode(keys) == 0o700
    assert sorted(path.name for path in keys.iterdir()) == ["client.key", "server.key"]
    assert {mode(path) for path in keys.iterdir()} == {0o600} and mode(file) == 0o600


def test_what_is_created_is_loaded_and_always_fresh(paths: tuple[Path, Path], tmp_path: Path, ros_domain: int) -> None:
    loaded = bifrost.Network.load(*paths)
    assert loaded == bifrost.Network.load(*paths) and loaded.computer == loaded.computers[0]
    assert loaded.computer.daemon == f"tcp://127.0.0.1:{loaded.computer.port}"
    assert loaded.client != loaded.server and str(loaded.client.secret) not in repr(loaded)
    other = bifrost.Network.create(tmp_path / "other.json", tmp_path / "other")
    assert other.client.public != loaded.client.public
    ports = daemon_ports(ros_domain)[-3:]
    again = bifrost.Network.create(*paths, ports=ports)
    assert bifrost.Network.load(*paths) == again and again.client != loaded.client and again.computer.port in ports


def test_from_environment(paths: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("BIFROST_NETWORK", raising=False)
    with pytest.raises(bifrost.ConfigurationError, match=r"^BIFROST_NETWORK is not set: expected the path"):
        bifrost.Network.from_environment()
    monkeypatch.setenv("BIFROST_NETWORK", str(paths[0]))
    monkeypatch.setenv("BIFROST_KEYS", str(paths[1]))
    assert bifrost.Network.from_environment() == bifrost.Network.load(*paths)


COMPUTER = {"name": "a", "host": "127.0.0.1", "port": 1}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "expected JSON"),
        ([], "version: expected 1"),
        ({"version": 2, "computers": [COMPUTER]}, "version: expected 1"),
        ({"version": 1}, "missing required field `computers`"),
        (
            {"version": 1, "computers": [COMPUTER | {"name": "a b"}]},
            r"matching regex .* - at `\$\.computers\[0\]\.name`",
        ),
        ({"version": 1, "computers": [COMPUTER | {"port": 70000}]}, r"<= 65535 - at `\$\.computers\[0\]\.port`"),
        ({"version": 1, "computers": [COMPUTER, COMPUTER]}, "computers: expected names that differ"),
        ({"version": 1, "computers": [COMPUTER, COMPUTER | {"name": "b"}]}, "set BIFROST_COMPUTER"),
    ],
)
def test_a_wrong_network_file_is_named_with_the_key(paths: tuple[Path, Path], content: Any, message: str) -> None:
    file, keys = paths
    file.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(bifrost.ConfigurationError, match=message) as caught:
        bifrost.Network.load(file, keys)
    assert str(file) in str(caught.value) and "\n" not in str(caught.value)


def test_one_of_several_computers(paths: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    file, keys = paths
    computers = [COMPUTER, COMPUTER | {"name": "b", "port": 2}]
    file.write_text(json.dumps({"version": 1, "computers": computers}))
    assert bifrost.Network.load(file, keys, "b").computer.port == 2
    monkeypatch.setenv("BIFROST_COMPUTER", "a")
    assert bifrost.Network.load(file, keys).computer.port == 1
    with pytest.raises(bifrost.ConfigurationError, match=r"no computer 'c'; expected one of a, b$"):
        bifrost.Network.load(file, keys, "c")


def test_keys_that_are_missing_open_to_others_or_no_keys(paths: tuple[Path, Path], tmp_path: Path) -> None:
    file, keys = paths
    with pytest.raises(bifrost.ConfigurationError, match="none: no such folder of Bifrost keys"):
        bifrost.Network.load(file, tmp_path / "none")
    key = keys / "client.key"
    key.chmod(0o640)
    with pytest.raises(bifrost.ConfigurationError, match=r"client\.key: mode 0640: expected 0600"):
        bifrost.Network.load(file, keys)
    key.chmod(0o600)
    good = key.read_bytes()
    for content in (b"", b"x", good[:-5], good + b"more", b"~" * 40 + b"\n" + b"~" * 40, good[41:] + good[:41]):
        key.write_bytes(content)
        with pytest.raises(bifrost.ConfigurationError, match=r"client\.key: expected a"):
            bifrost.Network.load(file, keys)
    key.unlink()
    with pytest.raises(bifrost.ConfigurationError, match=r"client\.key: no such Bifrost key"):
        bifrost.Network.load(file, keys)


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    obstacle = tmp_path / "file"
    obstacle.write_text("")
    with pytest.raises(bifrost.ConfigurationError, match="file"):
        bifrost.Network.create(obstacle / "network.json", tmp_path / "keys")


def test_an_address_that_is_not_ours_is_named(tmp_path: Path) -> None:
    with pytest.raises(bifrost.ConfigurationError, match=r"no free port for the daemon on 192\.0\.2\.1"):
        bifrost.Network.create(tmp_path / "network.json", tmp_path / "keys", host="192.0.2.1")


def test_wrong_node_names(paths: tuple[Path, Path]) -> None:
    network = bifrost.Network.load(*paths)
    for name in ("", "a b", "a\nb", "x" * 300):
        with pytest.raises(ValueError, match="node name"):
            bifrost.Node(name, network=network)
