"""What is in the wheels and the source distributions, and Bifrost by itself."""

import os
import subprocess
import tarfile
import textwrap
import zipfile
from pathlib import Path

import pytest

import bifrost
from harness.places import REPOSITORY
from harness.waiting import wait_until
from tests.integration import wheels
from valor.valorctl.instance.ros_domain import daemon_ports

pytestmark = pytest.mark.timeout(wheels.TIMEOUT)
DATA = "valor/common/data"


@pytest.fixture(scope="module")
def dist() -> Path:
    return wheels.dist()


def only(folder: Path, pattern: str) -> Path:
    [file] = folder.glob(pattern)
    return file


def files(folder: Path, under: str) -> set[str]:
    """Names of all files in a folder, links followed, as they shall be under another name."""
    found = (Path(place) / name for place, _, names in os.walk(folder, followlinks=True) for name in names)
    return {f"{under}/{file.relative_to(folder)}" for file in found if file.suffix != ".pyc"}


def test_the_wheel_of_the_project_holds_one_package_with_its_data_and_nothing_twice(dist: Path) -> None:
    names = zipfile.ZipFile(only(dist, "valor-*.whl")).namelist()
    assert len(names) == len(set(names))
    expected = files(REPOSITORY / "valor", "valor")
    for folder in ("robots", "deploy", "examples"):
        expected |= files(REPOSITORY / folder, f"{DATA}/{folder}")
    assert {name for name in names if ".dist-info/" not in name} == expected
    assert {f"valor/{each.name}/__main__.py" for each in (REPOSITORY / "services").iterdir()} <= set(names)
    assert {Path(name).name for name in names if "/licenses/" in name} == {"LICENSE", "NOTICE"}


@pytest.mark.parametrize("package", ["bifrost", "thesis"])
def test_the_wheel_of_another_distribution_holds_its_package_only(dist: Path, package: str) -> None:
    names = zipfile.ZipFile(only(dist, f"valor_{package}-*.whl")).namelist()
    modules = {str(file.relative_to(REPOSITORY)) for file in (REPOSITORY / package).rglob("*.py")}
    assert {name for name in names if ".dist-info/" not in name} == modules | {f"{package}/py.typed"}
    assert any(name.endswith("licenses/LICENSE") for name in names)


@pytest.mark.parametrize("project", ["valor", "valor_bifrost", "valor_thesis"])
def test_a_source_distribution_has_no_links_and_nothing_twice(dist: Path, project: str) -> None:
    with tarfile.open(only(dist, f"{project}-*.tar.gz")) as archive:
        members = archive.getmembers()
    assert all(member.isfile() for member in members)
    assert len({member.name for member in members}) == len(members)
    assert not [member.name for member in members if "/tests/" in member.name or "/services/" in member.name]


def test_the_readme_leads_nowhere_that_a_package_page_does_not_have(dist: Path) -> None:
    with zipfile.ZipFile(only(dist, "valor-*.whl")) as archive:
        [metadata] = [archive.read(name).decode() for name in archive.namelist() if name.endswith("/METADATA")]
    assert "# valor\n" in metadata
    assert "![" not in metadata and "](" not in metadata.replace("](https://", "")


def test_bifrost_works_by_itself(dist: Path, tmp_path: Path, ros_domain: int) -> None:
    wheels.install([only(dist, "valor_bifrost-*.whl")], tmp_path / "venv")
    home = tmp_path / "empty"
    home.mkdir()
    environment = wheels.Environment(tmp_path / "venv", home)
    assert "valor" not in environment.run("python", "-m", "bifrost.cli", "--help").stdout
    assert "No module named 'valor'" in environment.run("python", "-c", "import valor", expect=1).stderr
    bifrost.Network.create(home / "network.json", home / "keys", ports=daemon_ports(ros_domain))
    joined = environment.variables | {
        "BIFROST_NETWORK": str(home / "network.json"), "BIFROST_KEYS": str(home / "keys"),
    }  # fmt: skip
    publishing = """
        import time, bifrost
        class Temperature(bifrost.Message):
            celsius: float
        with bifrost.Node("thermometer") as node:
            publisher = node.publisher("lab/temperature", Temperature)
            while True:
                publisher.publish(Temperature(21.5))
                time.sleep(0.01)
        """
    python = environment.folder / "bin/python"
    commands = (["-m", "bifrost.daemon"], ["-c", textwrap.dedent(publishing)])
    running = [subprocess.Popen([python, *command], env=joined, cwd=home) for command in commands]
    try:
        network = bifrost.Network.load(home / "network.json", home / "keys")
        wait_until(lambda: bifrost.daemon_alive(network, timeout=0.5) is not None, 30.0, "bifrostd answers")
        received = subprocess.run(
            [python, "-m", "bifrost.cli", "topic", "echo", "lab/temperature", "--once", "--timeout", "30"],
            env=joined, cwd=home, capture_output=True, text=True, timeout=60.0, check=True,
        )  # fmt: skip
        assert "21.5" in received.stdout
    finally:
        for process in running:
            process.terminate()
        for process in running:
            process.wait(10.0)
