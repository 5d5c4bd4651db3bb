"""A signal at any moment, imports included: one line, the exit status of the signal, no traceback."""

from __future__ import annotations

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
    """Whether a traceback, or part of it, is of our code; not of the interpreter's own start before it, say."""
    return "Traceback" in traceback and "valor" in "".join(
        line for line in traceback.splitlines() if line.lstrip().startswith("File") and "bin/valorctl" not in line
    )


@pytest.mark.parametrize("arguments", [["status"], ["up", "-h"], ["topic", "list"], ["logs"]], ids=" ".join)
def test_ctrl_c_ends_in_one_line_whenever_it_comes(arguments: list[str], tmp_path: Path) -> None:
    environment = os.environ | {"VALOR_HOME": str(tmp_path)}
    start, end = lasts(sys.executable, "-c", "pass"), lasts(VALORCTL, *arguments)
    moments = random.Random(7)
    for _ in range(6):
        process = subprocess.Popen(
            [VALORCTL, *arguments], env=environment, text=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        time.sleep(moments.uniform(start, end))
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=60)
        assert not ours(told), told
        if process.returncode == 128 + signal.SIGINT:
            assert told == "valorctl: interrupted by SIGINT\n"


SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.mark.parametrize("signum", SIGNALS, ids=lambda signum: signum.name)
def test_a_signal_during_imports_ends_in_one_line(signum: signal.Signals) -> None:
    code = (
        f"import os, signal, sys; signal.signal({int(signum)}, signal.SIG_DFL)  # nohup has one of them ignored\n"
        "from valor.valorctl import __main__ as valorctl\n"
        "class Import:\n"
        f"    def find_spec(self, name, *_): os.kill(os.getpid(), {int(signum)}) if name == 'typer' else None\n"
        "sys.meta_path.insert(0, Import())\n"
        "sys.argv[1:] = ['up', '-h']\n"
        "sys.exit(valorctl.main())"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (128 + signum, f"valorctl: interrupted by {signum.name}\n")


def test_ctrl_c_while_the_first_module_is_looked_for_ends_without_a_word() -> None:
    code = (
        "import os, signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Import:\n"
        "    def find_spec(self, name, *_): None if name.startswith('valor') else os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Import())\n"
        "for name in set(sys.modules) & {'__future__', 'contextlib', 'gc'}: del sys.modules[name]\n"
        "import valor.valorctl.__main__\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (-signal.SIGINT, "")
