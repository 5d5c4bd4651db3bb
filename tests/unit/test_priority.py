"""Control loops in real time, if the system grants it."""

import os
import subprocess
import sys

import pytest

from harness.places import REPOSITORY
from harness.turns import known
from valor.common.priority import BACKGROUND_NICENESS, SHORT_TURN

pytestmark = pytest.mark.portable

# In a process of its own: nobody wants the test runner in real time.
_LOOP = """
import os, sys, threading
from valor.common.priority import take_real_time

ended, ready = threading.Event(), threading.Event()
thread = threading.Thread(target=lambda: (ready.set(), ended.wait()))
thread.start()
ready.wait()
granted = take_real_time(int(sys.argv[1]))
for each in (threading.get_native_id(), thread.native_id):
    print(granted, os.sched_getscheduler(each) == os.SCHED_FIFO, os.sched_getparam(each).sched_priority)
ended.set()
"""


def _granted() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(3))
    except PermissionError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


@pytest.mark.parametrize("priority", [0, 3])
def test_a_loop_goes_first_and_its_other_threads_next_or_all_stay_as_they_are(priority: int) -> None:
    result = subprocess.run(
        [sys.executable, "-c", _LOOP, str(priority)], capture_output=True, text=True, check=True, timeout=60.0
    )
    expected = ["True True 3", "True True 2"] if priority and _granted() else ["False False 0"] * 2
    assert result.stdout.splitlines() == expected


_STOPPING = """
import contextlib, os, sys
from valor.valorctl.__main__ import main

with contextlib.suppress(SystemExit):
    main()
child = os.posix_spawn("/bin/true", ["true"], {})
own = os.sched_getscheduler(0) & os.SCHED_FIFO, os.sched_getparam(0).sched_priority
print("\\n", *own, os.sched_getscheduler(child))
"""


@pytest.mark.parametrize(("verb", "hurries"), [("stop", True), ("down", True), ("status", False)])
def test_a_stop_comes_next_after_the_loops_and_what_it_starts_does_not(verb: str, hurries: bool) -> None:
    result = subprocess.run(
        [sys.executable, "-c", _STOPPING, verb, "--help"], capture_output=True, text=True, check=True, timeout=60.0
    )
    assert result.stdout.split()[-3:] == (["1", "1", "0"] if hurries and _granted() else ["0", "0", "0"])


_CORES = """
import os, sys, threading
from valor.common.priority import take_cores

os.sched_setaffinity(0, set(map(int, sys.argv[2].split(","))))
core = take_cores(sys.argv[1])
found = []
thread = threading.Thread(target=lambda: found.append(os.sched_getaffinity(0)))
thread.start()
thread.join()
print(core, sorted(found[0]))
"""


@pytest.mark.parametrize("cores", ["own", "others", "any"])
def test_one_has_the_last_core_and_the_rest_keep_off_it_if_there_are_two(cores: str) -> None:
    def found(given: list[int]) -> str:
        command = [sys.executable, "-c", _CORES, cores, ",".join(map(str, given))]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60.0).stdout.strip()

    given = sorted(os.sched_getaffinity(0))
    assert found(given[:1]) == f"None {given[:1]}"
    if len(given) > 1:
        expected = {"own": given[-1:], "others": given[:-1], "any": given}[cores]
        assert found(given) == f"{given[-1]} {expected}"


_TURNS = """
import sys, threading
from harness.turns import turns
from valor.common.priority import take_turns

found = [turns()]
take_turns(sys.argv[1])
thread = threading.Thread(target=lambda: found.append(turns()))
thread.start()
thread.join()
print(*found[0], *found[1])
"""


@pytest.mark.skipif(not known(), reason="how this machine's kernel is asked is not known here")
@pytest.mark.parametrize("wanted", ["short", "usual", "background"])
def test_turns_are_those_of_all_threads_started_from_now_on(wanted: str) -> None:
    command = [sys.executable, "-c", _TURNS, wanted]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60.0, cwd=REPOSITORY)
    policy, niceness, usual, policy_now, niceness_now, length = map(int, result.stdout.split())
    if wanted == "background":
        assert (policy_now, niceness_now) == (os.SCHED_BATCH, max(niceness, BACKGROUND_NICENESS))
        assert length == usual
        return
    assert (policy_now, niceness_now) == (policy, niceness)
    # A Linux that does not know of turns, or does not report them, leaves them as they are.
    assert length in ({round(SHORT_TURN * 1e9), usual} if wanted == "short" else {usual})
