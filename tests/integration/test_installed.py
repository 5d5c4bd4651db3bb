"""The robot in an environment and a folder that know nothing of a checkout: what comes with the wheels is enough."""

import json
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from harness.places import REPOSITORY
from harness.system import leftovers, shared_memory
from tests.integration import wheels
from valor.common.instance import Instance

pytestmark = pytest.mark.timeout(wheels.TIMEOUT)


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("installed") / "venv"
    wheels.install([*wheels.dist().glob("*.whl"), wheels.interfaces()], folder)
    return folder


@pytest.fixture
def installed(environment: Path, home: Path) -> Iterator[wheels.Environment]:
    made = wheels.Environment(environment, home)
    yield made
    for name in ("default", "demo"):
        if Instance(name, home).settings_file.exists():
            made.run("valorctl", "down", "--instance", name)


def test_one_name_for_all_that_is_installed(installed: wheels.Environment) -> None:
    listed = installed.run("python", "-c", "import importlib.metadata as m; print(*m.files('valor'), sep='\\n')").stdout
    roots = {Path(line).parts[0] for line in listed.splitlines() if not line.startswith("..")}
    assert {root for root in roots if not root.endswith(".dist-info")} == {"valor"}
    assert installed.run("valorctl", "--version").stdout == f"valor {version()}\n"


def version() -> str:
    output: str = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["version"]
    return output


def test_a_robot_stands_reaches_and_walks_with_no_checkout(installed: wheels.Environment) -> None:
    findings = {
        each["check"]: each for each in json.loads(installed.run("valorctl", "doctor", "--json", expect=None).stdout)
    }
    assert findings["ros"]["level"] == "ok" and "make setup" not in json.dumps(findings)
    before = shared_memory()
    output = installed.run("valorctl", "demo", "--rtf", "0").stdout
    made = {file.name for file in (installed.home / "output/demo").iterdir()}
    assert {"demo.mcap", "before_after.png", "on_the_way.png", "dynamics.png"} <= made
    assert "walked 3." in output and f"{installed.folder}/bin/valorctl demo walk" in output
    assert leftovers(installed.home, "demo", before) == []


def test_up_status_and_down_with_no_checkout_and_no_opengl(installed: wheels.Environment, tmp_path: Path) -> None:
    for name in ("libEGL.so", "libEGL.so.1"):
        (tmp_path / name).touch()  # what is no library is as good as none
    without = {"MUJOCO_GL": "egl", "LD_LIBRARY_PATH": str(tmp_path)}
    assert "eglQueryString" in replace(installed, more=without).run("python", "-c", "import mujoco", expect=1).stderr
    installed = replace(installed, more={"LD_LIBRARY_PATH": str(tmp_path)})
    before = shared_memory()
    installed.run("valorctl", "up", "--world", "dirt", "--rtf", "0")
    services = json.loads(installed.run("valorctl", "status", "--json").stdout)["services"]
    assert all(service["state"] == "ready" for service in services)
    installed.run("valorctl", "down")
    assert leftovers(installed.home, "default", before) == []
