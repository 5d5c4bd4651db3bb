"""A signal at any moment, imports included: one line, the exit status of the signal, no traceback."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

VALORCTL = Path(sys.executable).with_name("valorctl")


def lasts(*command: str | Path) -> float:
    """How long a command takes now [s]."""
    began = time.monotonic()
    subprocess.run(command, capture_output=True, check=False)
    return time.monotonic() - began


def ours(traceback: str) -> bool:
    """Return whether a traceback, or part of it, is of our code; not of the interpreter's own start before it, say."""
    return "Traceback" in traceback and "valor" in "".join(
        line for line in traceback.splitlines() if line.lstrip().startswith("File") and "bin/valorctl" not in line
    )


@pytest.mark.parametrize("arguments", [["status"], ["up", "-h"], ["topic", "list"], ["logs"]], ids=" ".join)
def test_ctrl_c_at_any_moment_ends_in_one_line(arguments: list[str], tmp_path: Path) -> None:
    environment = os.environ | {"VALOR_HOME": str(tmp_path)}
    start, end = lasts(sys.executable, "-c", "pass"), lasts(VALORCTL, *arguments)
    moments = random.Random(7)
    for _ in range(6):
        process = subprocess.Popen(
            [VALORCTL, *arguments], env=environment, text=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        time.sleep(moments.uniform(start, end))
        process.send_signal(signal.SIGINT)
        _, output = process.communicate(timeout=60)
        assert not ours(output), output
        if process.returncode == 128 + signal.SIGINT:
            assert output == "valorctl: interrupted by SIGINT\n"
