"""Which state a process is in, from supervisord's word and its own; restarts; arm motions' duration."""

from __future__ import annotations

from pathlib import Path

import pytest

from valor.common.errors import ValorError
from valor.common.resources import robot_folder
from valor.robot.commanded_limits import VELOCITY_FACTOR
from valor.robot.description import RobotDescription
from valor.valorctl.arm_motion import SIDES, Limb, preset, trajectory_duration
from valor.valorctl.health import SILENCE, START_GRACE, Word, judge
from valor.valorctl.supervision import ProcessInfo, ProcessState, count_restarts, last_end

NOW = 1000.0


def info(state: ProcessState, pid: int = 7, uptime: float = 60.0) -> ProcessInfo:
    return ProcessInfo("x", state, pid, uptime, exit_status=78, problem="no such file")


def word(state: str, pid: int = 7, age: float = 0.5) -> Word:
    return Word(pid, state, "waits for y", 12.0, 34.0, NOW - age)


@pytest.mark.parametrize(
    ("process", "said", "state", "detail"),
    [
        (info(ProcessState.RUNNING), word("ready"), "ready", ""),
        (info(ProcessState.RUNNING), word("starting"), "starting", "waits for y"),
        (info(ProcessState.STARTING), word("starting"), "starting", "waits for y"),
        (info(ProcessState.RUNNING), word("degraded"), "degraded", "waits for y"),
        (info(ProcessState.RUNNING), word("stopping"), "stopped", ""),
        (info(ProcessState.RUNNING), word("ready", age=SILENCE + 1), "failed", "silent"),
        (info(ProcessState.RUNNING), word("ready", pid=6), "failed", "no word"),
        (info(ProcessState.RUNNING, uptime=START_GRACE / 2), word("ready", pid=6), "starting", "no word"),
        (info(ProcessState.RUNNING, uptime=START_GRACE / 2), None, "starting", "no word"),
        (info(ProcessState.RUNNING), None, "failed", "no word"),
        (info(ProcessState.STOPPED, pid=0), word("ready"), "stopped", ""),
        (info(ProcessState.STOPPING), word("ready"), "stopped", "stopping"),
        (info(ProcessState.EXITED, pid=0), word("ready"), "failed", "78"),
        (info(ProcessState.FATAL, pid=0), None, "failed", "no such file"),
        (info(ProcessState.BACKOFF, pid=0), None, "failed", "no such file"),
    ],
)
def test_the_state_is_what_both_words_agree_on(
    process: ProcessInfo, said: Word | None, state: str, detail: str
) -> None:
    health = judge(process, said, NOW, restarts=3)
    assert health.state == state
    assert detail in health.detail
    assert health.restarts == 3


def test_restarts_are_ends_that_nobody_asked_for(tmp_path: Path) -> None:
    log = tmp_path / "supervisord.log"
    assert count_restarts(log) == {} and last_end(log, "a") == ""
    log.write_text(
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


@pytest.mark.parametrize("limb", ["arm", "hand"])
def test_presets_are_known_by_name(escher: RobotDescription, limb: Limb) -> None:
    presets = {"arm": escher.tables.arm_presets, "hand": escher.tables.hand_presets}[limb]
    for name, sides in presets.items():
        for side in SIDES:
            if side in sides:
                assert preset(escher, side, limb, name) == sides[side]
    with pytest.raises(ValorError, match=f"left {limb}.*{next(iter(presets))}"):
        preset(escher, "left", limb, "backflip")


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
