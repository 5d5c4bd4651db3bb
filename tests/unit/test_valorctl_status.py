"""`status`: factors of robot time, state of the robot, next command."""

import subprocess
import sys
import time
from dataclasses import replace
from datetime import datetime
from io import StringIO
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

import bifrost
from valor.common.errors import ValorError
from valor.common.instance import ClockMode, Instance, Settings
from valor.common.messages import ClockStatus
from valor.common.processes import BY_NAME
from valor.common.resources import robot_folder
from valor.robot.commanded_limits import VELOCITY_FACTOR
from valor.robot.description import RobotDescription
from valor.valorctl.drive.arm_motion import preset, trajectory_duration
from valor.valorctl.instance import checks
from valor.valorctl.instance.supervision import ProcessInfo, ProcessState, count_restarts, last_end
from valor.valorctl.status.health import REPORT_TIMEOUT, START_GRACE, Health, ProcessReport, judge
from valor.valorctl.status.status import Condition, Status
from valor.valorctl.status.status_view import BAD, view


def status(mode: ClockMode, pace: float, robot_time: float, slip: float) -> Status:
    settings = Settings(robot=Path("escher"), ros_domain_id=1, clock=mode, real_time_factor=pace)
    clock = ClockStatus(mode, round(robot_time * 1e9), 1.0, slip, 0, False)
    return Status("default", settings, None, None, clock, [])


@given(st.floats(0.1, 8.0), st.floats(0.01, 1e5), st.floats(0.0, 1e3))
def test_wall_time_is_robot_time_and_slip_at_the_real_time_factor(pace: float, passed: float, slip: float) -> None:
    seen = status("lockstep", pace, passed, slip)
    factor = seen.factor_since_start
    assert factor is not None and seen.as_json()["clock"]["real_time_factor_since_start"] == factor
    on_the_wall = (passed + slip) / pace
    assert factor * on_the_wall == pytest.approx(passed, rel=1e-6)
    # In realtime the pace is the wall's own, whatever the settings say of lockstep's.
    assert status("realtime", pace, passed, slip).factor_since_start == pytest.approx(factor / pace)
    assert status("lockstep", 0.0, passed, slip).factor_since_start is None
    assert status("lockstep", pace, 0.0, 0.0).factor_since_start is None
    assert replace(seen, clock=None).factor_since_start is None


def shown(status: Status, width: int) -> list[str]:
    screen = StringIO()
    console = Console(width=width, highlight=False, file=screen)
    console.print(view(status))
    return screen.getvalue().splitlines()


BEGAN = time.time() - 44.0
BAG = Path("/home/somebody/.valor/lab/bags/2026-01-31_14-05-00/2026-01-31_14-05-00.mcap")
FALLEN = replace(
    status("lockstep", 1.0, 45.0, 12.3), instance="lab", behavior="fall", control_mode="none",
    condition=Condition("the pelvis is tilted 62°", 42.0, BEGAN, BAG),
    services=[Health("motion_manager", "failed", 1234567, 100.0, 1108.0, 12, "runs, but silent for 12.3 s")],
)  # fmt: skip


def test_a_fall_is_shown_with_reason_time_command_and_bag() -> None:
    width = 80
    lines = shown(FALLEN, width)
    text = "\n".join(lines)
    assert (
        f"fallen since {datetime.fromtimestamp(BEGAN):%H:%M:%S} (42.0 s of robot time): the pelvis is tilted 62°"
        in lines
    )
    assert "→ valorctl reset --instance lab" in lines
    assert str(BAG) in text
    assert all(len(line.rstrip()) <= width for line in lines)
    colours = {span.style for line in view(FALLEN).renderables[:5] for span in getattr(line, "spans", ())}
    assert BAD in colours
    assert f"100 of {BY_NAME['motion_manager'].cpu_budget:.0f}" in "\n".join(shown(FALLEN, 120))
    output = FALLEN.as_json()
    assert (output["fallen"], output["since_s"], output["bag"]) == (True, 42.0, str(BAG))
    assert output["way_out"] == "valorctl reset --instance lab"


def test_a_fallen_robot_that_is_not_simulated_gets_up_or_is_hung_upright() -> None:
    real = replace(FALLEN, settings=Settings(robot=Path("escher"), ros_domain_id=1, variant="hardware"))
    text = " ".join(shown(real, 200))
    assert real.way_out == "valorctl get-up --instance lab" and real.way_out in text
    assert "`valorctl stop --freeze`, `valorctl mode stand_prep`" in text and "reset" not in text


def test_paused_time_is_shown_with_the_command_that_resumes_it() -> None:
    assert FALLEN.clock is not None
    paused = replace(FALLEN, clock=msgspec.structs.replace(FALLEN.clock, mode="paused"))
    assert "robot time is paused" in shown(paused, 80)
    assert "→ valorctl time resume --instance lab" in shown(paused, 80)
    assert paused.as_json()["way_out"] == "valorctl time resume --instance lab"


def test_a_standing_robot_needs_no_command() -> None:
    standing = replace(
        FALLEN, behavior="stand", condition=Condition("requested by somebody", 1.0, time.time() - 44.0, None)
    )
    text = "\n".join(shown(standing, 120))
    assert "behavior stand for 44 s: requested by somebody" in text and "→" not in text
    assert standing.as_json()["way_out"] is None and standing.as_json()["fallen"] is False
    frozen = shown(replace(standing, frozen=["left_arm", "neck"]), 120)
    assert "frozen: left_arm, neck → valorctl mode freeze --joints none --instance lab" in frozen


# State of a process from supervisord and from its own reports; restarts; arm motions' duration.
NOW = 1000.0


def info(state: ProcessState, pid: int = 7, uptime: float = 60.0) -> ProcessInfo:
    return ProcessInfo("x", state, pid, uptime, exit_status=78, problem="no such file")


def report(state: str, pid: int = 7, age: float = 0.5) -> ProcessReport:
    return ProcessReport(pid, state, "waits for y", 12.0, 34.0, NOW - age)


@pytest.mark.parametrize(
    ("process", "said", "state", "detail"),
    [
        (info(ProcessState.RUNNING), report("ready"), "ready", ""),
        (info(ProcessState.RUNNING), report("starting"), "starting", "waits for y"),
        (info(ProcessState.STARTING), report("starting"), "starting", "waits for y"),
        (info(ProcessState.RUNNING), report("degraded"), "degraded", "waits for y"),
        (info(ProcessState.RUNNING), report("stopping"), "stopped", ""),
        (info(ProcessState.RUNNING), report("ready", age=REPORT_TIMEOUT + 1), "failed", "no report for"),
        (info(ProcessState.RUNNING), report("ready", pid=6), "failed", "no report"),
        (info(ProcessState.RUNNING, uptime=START_GRACE / 2), report("ready", pid=6), "starting", "no report"),
        (info(ProcessState.RUNNING, uptime=START_GRACE / 2), None, "starting", "no report"),
        (info(ProcessState.RUNNING), None, "failed", "no report"),
        (info(ProcessState.STOPPED, pid=0), report("ready"), "stopped", ""),
        (info(ProcessState.STOPPING), report("ready"), "stopped", "stopping"),
        (info(ProcessState.EXITED, pid=0), report("ready"), "failed", "78"),
        (info(ProcessState.FATAL, pid=0), None, "failed", "no such file"),
        (info(ProcessState.BACKOFF, pid=0), None, "failed", "no such file"),
    ],
)
def test_the_state_combines_supervisord_and_report(
    process: ProcessInfo, said: ProcessReport | None, state: str, detail: str
) -> None:
    health = judge(process, said, NOW, restarts=3)
    assert health.state == state and detail in health.detail and health.restarts == 3


@pytest.mark.parametrize("said", [report("ready", age=569.0), report("starting"), None])
def test_a_process_that_waits_for_paused_time_has_not_failed(said: ProcessReport | None) -> None:
    health = judge(info(ProcessState.RUNNING), said, NOW, paused=True)
    assert (health.state, health.detail) == ("ready", "robot time is paused")
    assert judge(info(ProcessState.EXITED, pid=0), said, NOW, paused=True).state == "failed"


def test_restarts_are_unexpected_ends() -> None:
    assert count_restarts("") == {} and last_end("", "a") == ""
    log = (
        "2026-01-01 00:00:00,000 INFO spawned: 'a' with pid 1\n"
        "2026-01-01 00:00:01,000 WARN exited: a (terminated by SIGKILL; not expected)\n"
        "2026-01-01 00:00:02,000 WARN exited: a (exit status 1; not expected)\n"
        "2026-01-01 00:00:03,000 INFO exited: b (exit status 78; expected)\n"
        "2026-01-01 00:00:04,000 INFO stopped: c (exit status 0)\n"
    )
    assert count_restarts(log) == {"a": 2}
    ends = {name: last_end(log, name) for name in ("a", "b", "c")}
    assert ends == {"a": "exit status 1", "b": "exit status 78", "c": ""}


@pytest.fixture(scope="module")
def escher() -> RobotDescription:
    return RobotDescription.load(robot_folder("escher"))


def test_presets_are_known_by_name(escher: RobotDescription) -> None:
    assert preset(escher, "left", "hand", "open") == escher.tables.hand_presets["open"]["left"]
    with pytest.raises(ValorError, match=f"left arm.*{next(iter(escher.tables.arm_presets))}"):
        preset(escher, "left", "arm", "backflip")


def test_no_joint_exceeds_its_share_of_the_speed_limit(escher: RobotDescription) -> None:
    joints = escher.tables.groups["right_arm"]
    start = dict.fromkeys(joints, 0.0)
    goal = start | {joints[2]: 1.5, joints[4]: -0.2}
    duration = trajectory_duration(escher, start, goal, speed=0.5)
    limit = VELOCITY_FACTOR * escher.tables.joints[joints[2]].velocity
    # The quintic 10s³ − 15s⁴ + 6s⁵ is steepest in its middle.
    middle = 30 * 0.5**2 - 60 * 0.5**3 + 30 * 0.5**4
    assert 1.5 / duration * middle == pytest.approx(0.5 * limit)
    assert trajectory_duration(escher, start, start, speed=0.5) == 1.0


# ``valorctl doctor``: keys readable by other users, and real time.
@pytest.mark.parametrize(("name", "mode"), [("client.key", 0o640), ("server.key", 0o604), ("", 0o750)])
def test_keys_readable_by_other_users_fail(tmp_path: Path, name: str, mode: int) -> None:
    instance = Instance("doctored", tmp_path)
    check = checks.CHECKS["keys"]
    assert check(instance)[0] == "ok"  # it is down: there are none
    bifrost.Network.create(instance.network_file, instance.keys)
    assert check(instance)[0] == "ok"
    (instance.keys / name).chmod(mode)
    level, text, *advice = check(instance)
    assert level == "fail"
    assert str(instance.keys / name) in text and f"{mode:04o}" in text
    assert "chmod" in advice[0]


# As a user with limits, not as root, who has none.
_WITH_LIMITS = """
import os, resource, sys
from pathlib import Path
from valor.common.instance import Instance
from valor.valorctl.instance import checks

check = checks.CHECKS["real time"]
for which, limit in zip((resource.RLIMIT_RTPRIO, resource.RLIMIT_NICE), map(int, sys.argv[1:])):
    try:
        resource.setrlimit(which, (limit, limit))
    except ValueError:
        sys.exit(77)
if os.geteuid() == 0:
    os.setuid(65534)
level, text, *advice = check(Instance("doctored", Path("/nowhere")))
print(level, text, *advice or [""], sep="\\n")
"""


@pytest.mark.parametrize(
    ("rtprio", "nice", "level", "words"),
    [
        (20, 0, "ok", "SCHED_FIFO, priority 20"),
        (0, 30, "warn", "at nice -10 on hardware"),  # the limit is 20 - nice
        (0, 0, "warn", "run at nice 0"),
    ],
)
def test_the_check_of_real_time_reports_the_granted_priority(rtprio: int, nice: int, level: str, words: str) -> None:
    output = subprocess.run(
        [sys.executable, "-c", _WITH_LIMITS, str(rtprio), str(nice)], capture_output=True, text=True, check=False,
        timeout=60.0,
    )  # fmt: skip
    if output.returncode == 77:
        pytest.skip("this user may not have what is to be granted")
    assert output.returncode == 0, output.stderr
    found, text, advice = output.stdout.splitlines()
    assert found == level and words in text, output.stdout
    assert ("rtprio 20" in advice) is (level == "warn")
