"""valorctl called as a user would, and what it must have left behind."""

import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from valor.common.instance import Instance
from valor.valorctl.status.status import Watch

VALORCTL = Path(sys.executable).with_name("valorctl")
TIMEOUT = 120.0  # of one call [s]
PATIENCE = 60.0  # [s]
BIFROST_ALONE = "description: the name service\nprocesses: [bifrostd]\n"
MOTION_SYSTEM = "description: no ROS\nprocesses: [bifrostd, comms_manager, motion_manager]\n"


@dataclass
class Cli:
    """Calls valorctl as a user would: from another folder, with nothing of ours in the environment but the home."""

    home: Path
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("VALOR_", "BIFROST_", "ROS_"))}
        process = subprocess.Popen(
            [VALORCTL, *arguments], env=environment | {"VALOR_HOME": str(self.home)}, cwd="/",
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, umask=0o022,
        )  # fmt: skip
        self.started.append(process)
        return process

    def __call__(self, *arguments: str, status: int = 0) -> str:
        """Its standard output, or when ``status`` is not 0 its standard error."""
        process = self.start(*arguments)
        out, err = process.communicate(timeout=TIMEOUT)
        assert process.returncode == status, f"{arguments} ended with {process.returncode}: {out}{err}"
        assert "Traceback" not in err
        if status == 0:
            return out
        assert status == 2 or err.startswith("valorctl: "), err
        return err

    def status(self, instance: str = "default") -> dict[str, Any]:
        """What ``status --json`` prints, with the services by name."""
        with Watch(Instance(instance, self.home)) as watch:
            content = watch.look().as_json()
        return content | {"services": {service["name"]: service for service in content["services"]}}

    def pid(self, service: str, instance: str = "default") -> int:
        pid = self.status(instance)["services"][service]["pid"]
        assert isinstance(pid, int)
        return pid

    def supervisord(self, instance: str = "default") -> int:
        return int((self.home / instance / "supervisord.pid").read_text())

    def profile(self, text: str) -> str:
        file = self.home / f"profile-{len(list(self.home.glob('profile-*')))}.yaml"
        file.write_text(text)
        return str(file)

    def processes(self) -> list[psutil.Process]:
        """Every process whose environment names this home, but for valorctl itself."""
        found = []
        for process in psutil.process_iter():
            try:
                if process.environ().get("VALOR_HOME") == str(self.home) and process.status() != "zombie":
                    found.append(process)
            except psutil.Error:
                continue
        ours = {process.pid for process in self.started if process.poll() is None}
        return [process for process in found if process.pid not in ours]

    def assert_private(self, *others: Path) -> None:
        """Nobody but their user may read or write, or look into, what is an instance's."""
        files = [path for path in (self.home / "default").rglob("*") if not path.is_symlink()]
        assert [str(path) for path in (self.home / "default", *files, *others) if path.stat().st_mode & 0o077] == []

    def assert_nothing_left(self, instance: str = "default") -> None:
        """Processes, sockets, files: only logs and bags stay."""
        assert [" ".join(p.cmdline()) for p in self.processes()] == []
        left = {path.name for path in (self.home / instance).iterdir()} if (self.home / instance).exists() else set()
        assert left <= {"logs", "bags"}


def shared_memory(processes: list[psutil.Process]) -> set[str]:
    """What they hold but for LTTng's, which are the user's: one for all programs that can be traced."""
    lines = [line for p in processes for line in Path(f"/proc/{p.pid}/maps").read_text().splitlines()]
    return {line[line.index("/dev/shm/") :] for line in lines if "/dev/shm/" in line and "lttng" not in line}
