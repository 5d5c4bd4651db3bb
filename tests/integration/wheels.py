"""The project's wheels as `make dist` builds them, and environments into which nothing but wheels is installed."""

import functools
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from harness.places import REPOSITORY

BUILD = REPOSITORY / "build"
REQUIREMENTS = REPOSITORY / "requirements.txt"
PROJECTS = (REPOSITORY, REPOSITORY / "bifrost", REPOSITORY / "thesis")
TIMEOUT = 600.0  # of one call, and of a test [s]


def uv(*arguments: str | Path) -> None:
    """What ``make setup`` installs with."""
    program = shutil.which("uv") or BUILD / "uv/bin/uv"
    done = subprocess.run([program, *arguments], capture_output=True, text=True, timeout=TIMEOUT, check=False)
    assert done.returncode == 0, f"uv {' '.join(map(str, arguments))}: {done.stdout}{done.stderr}"


@functools.cache
def dist() -> Path:
    """Source distributions of the Python projects, and the wheels that these, not the checkout, build into."""
    out = BUILD / "tested"
    shutil.rmtree(out, ignore_errors=True)
    for project in PROJECTS:
        uv("build", "--quiet", "--python", sys.executable, project, "-o", out)
    return out


def interfaces() -> Path:
    """The wheel of the message packages: ``make setup`` compiled it."""
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    [wheel] = (BUILD / "wheels").rglob(f"valor_interfaces-*-{python}-*.whl")
    return wheel


@dataclass(frozen=True)
class Environment:
    """A virtual environment, used from a folder with nothing in it."""

    folder: Path
    home: Path  # VALOR_HOME, and the folder
    more: Mapping[str, str] = field(default_factory=dict)  # variables

    @property
    def variables(self) -> dict[str, str]:
        """Those of a shell that knows nothing of a checkout."""
        strangers = ("VALOR_", "BIFROST_", "ROS_", "_ROS_", "AMENT_", "LD_", "PYTHON", "VIRTUAL_ENV")
        kept = {name: value for name, value in os.environ.items() if not name.startswith(strangers)}
        return {**kept, "VALOR_HOME": str(self.home), **self.more}

    def run(self, program: str, *arguments: str, expect: int | None = 0) -> subprocess.CompletedProcess[str]:
        """Run one of its programs; its exit status must be ``expect`` (None: any)."""
        done = subprocess.run(
            [self.folder / "bin" / program, *arguments], env=self.variables, cwd=self.home, stdin=subprocess.DEVNULL,
            capture_output=True, text=True, timeout=TIMEOUT, check=False,
        )  # fmt: skip
        assert expect in (None, done.returncode), (
            f"{program} {arguments}: {done.returncode}\n{done.stdout}{done.stderr}"
        )
        return done


def install(wheels: Sequence[Path], folder: Path) -> None:
    """What ``pip install *.whl`` does in a new environment; of all else the versions that ``make setup`` installs."""
    uv("venv", "--quiet", "--python", sys.executable, folder)
    pip = ("pip", "install", "--quiet", "--python", folder / "bin/python", "--constraint", REQUIREMENTS)
    uv(*pip, *wheels)
