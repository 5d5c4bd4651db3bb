"""What ``valorctl doctor`` says of keys that others could read, and of real time."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bifrost
from valor.common.instance import Instance
from valor.valorctl import checks


@pytest.mark.parametrize(("name", "mode"), [("client.key", 0o640), ("server.key", 0o604), ("", 0o750)])
def test_keys_that_others_can_read_are_complained_of(tmp_path: Path, name: str, mode: int) -> None:
    instance = Instance("doctored", tmp_path)
    [check] = [each for each in checks.CHECKS if each.__name__ == "_keys"]
    assert check(instance).level == "ok"  # it is down: there are none
    bifrost.Network.create(instance.network_file, instance.keys)
    assert check(instance).level == "ok"
    (instance.keys / name).chmod(mode)
    finding = check(instance)
    assert finding.level == "fail"
    assert str(instance.keys / name) in finding.text and f"{mode:04o}" in finding.text
    assert finding.advice is not None and "chmod" in finding.advice


# As a user with limits, not as root, who has none.
_WITH_LIMITS = """
import os, resource, sys
from pathlib import Path
from valor.common.instance import Instance
from valor.valorctl import checks

[check] = [each for each in checks.CHECKS if each.__name__ == "_real_time"]
for which, limit in zip((resource.RLIMIT_RTPRIO, resource.RLIMIT_NICE), map(int, sys.argv[1:])):
    try:
        resource.setrlimit(which, (limit, limit))
    except ValueError:
        sys.exit(77)
if os.geteuid() == 0:
    os.setuid(65534)
finding = check(Instance("doctored", Path("/nowhere")))
print(finding.level, finding.text, finding.advice, sep="\\n")
"""


@pytest.mark.parametrize(
    ("rtprio", "nice", "level", "words"),
    [
        (20, 0, "ok", "SCHED_FIFO, priority 20"),
        (0, 30, "warn", "at nice -10 on hardware"),  # the limit is 20 - nice
        (0, 0, "warn", "like all else"),
    ],
)
def test_real_time_is_told_and_else_what_runs_instead(rtprio: int, nice: int, level: str, words: str) -> None:
    told = subprocess.run(
        [sys.executable, "-c", _WITH_LIMITS, str(rtprio), str(nice)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60.0,
    )
    if told.returncode == 77:
        pytest.skip("this user may not have what is to be granted")
    assert told.returncode == 0, told.stderr
    found, text, advice = told.stdout.splitlines()
    assert found == level and words in text, told.stdout
    assert ("rtprio 20" in advice) is (level == "warn")


@pytest.mark.skipif(shutil.which("chrt") is None, reason="no chrt to ask")
def test_real_time_is_granted_to_whom_the_system_grants_it(tmp_path: Path) -> None:
    [check] = [each for each in checks.CHECKS if each.__name__ == "_real_time"]
    granted = subprocess.run(["chrt", "-f", "20", "true"], capture_output=True, check=False).returncode == 0
    assert check(Instance("doctored", tmp_path)).level == ("ok" if granted else "warn")
