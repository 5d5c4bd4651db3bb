"""Search for the motions by which a robot gets up: the content of ``get_up.yaml``."""

from collections.abc import Iterator, Sequence

import numpy as np

from valor.common.arrays import FloatArray
from valor.get_up_planning.rollouts import Fallen, Rollouts, Target
from valor.get_up_planning.search import REACHES, Report, RollOver, Search, Squat, StandUp, find
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import Posture, attitude
from valor.robot.size import ESCHER

FALLS = 16  # towards each side
GAIN, LIMIT = 0.6, 0.15  # of the ankles with ESCHER's legs [rad/m]; angle [rad]
ROLL = 45.0  # of the pelvis, at most [deg]
ROOM = 30.0  # of the pelvis pitch around that of the simulated motions [deg]
_HEAD = """\
# Get Up of {robot}: motions of key poses, executed by the joints' servos (motion_manager/locomotion/get_up.py).
# Found by `valorctl robot get-up {robot}`. Duration and hold [s]; joints [rad], others stay;
# pitch of the pelvis afterwards [deg], out of which the motion is abandoned.
"""
_COLUMNS = 6  # joints per line


def plan(robot: RobotDescription, report: Report, seed: int = 0) -> str:
    """Return the content of ``get_up.yaml`` after minutes; ``report`` receives the progress.

    Raises ``NoMotionFoundError``.
    """
    rollouts = Rollouts(robot)
    falls = rollouts.fallen(range(FALLS))

    def found(search: Search, starts: Sequence[Fallen]) -> list[Target]:
        return find(search, starts, seed, report)

    squat = found(search := Squat(rollouts), falls)
    lying = [fall for fall in falls if fall.way is Posture.FACE]
    squatting = [
        Fallen(fall.mj, states[-1], squat[-1].goal, None)
        for fall, states in zip(lying, rollouts.play([(fall, squat) for fall in lying]), strict=True)
        if search.succeeded(states)
    ]
    rise = squat + found(StandUp(rollouts), squatting)
    roll = found(RollOver(rollouts), falls)
    return table(rollouts, lying, rise, roll)


def table(rollouts: Rollouts, lying: Sequence[Fallen], rise: Sequence[Target], roll: Sequence[Target]) -> str:
    """Return the content of the file; the pitch of the pelvis is that of the rises that succeed."""
    return "\n".join(_lines(rollouts, lying, rise, roll)) + "\n"


def _lines(
    rollouts: Rollouts, lying: Sequence[Fallen], rise: Sequence[Target], roll: Sequence[Target]
) -> Iterator[str]:
    robot, search = rollouts.robot, StandUp(rollouts)
    ends = [states for states in rollouts.play([(fall, rise) for fall in lying]) if search.succeeded(states)]
    pitch = np.array([[attitude(rollouts.upwards(state))[0] for state in states] for states in ends])
    yield _HEAD.format(robot=robot.name).rstrip()
    yield f"roll: {ROLL:g}  # of the pelvis, at most [deg]"
    gain = GAIN * ESCHER.leg / robot.tables.size.leg
    yield f"balance: {{ joints: [{', '.join(search.ankles)}], gain: {gain:.2f}, limit: {LIMIT:g} }}"
    yield "motions:"
    yield from _motion(
        rollouts, "face", Posture.STANDING, rise, np.stack([pitch.min(0) - ROOM, pitch.max(0) + ROOM], 1)
    )
    yield from _motion(rollouts, "right, back", Posture.FACE, roll, None)


def _motion(
    rollouts: Rollouts, start: str, to: Posture, targets: Sequence[Target], pitch: FloatArray | None
) -> Iterator[str]:
    robot, before = rollouts.robot, None
    yield from (f"  - from: [{start}]", f"    to: {to}", "    poses:")
    for i, target in enumerate(targets):
        goal = target.goal.round(3).clip(robot.lower, robot.upper)
        duration = target.duration if before is None else rollouts.move(before, target).duration
        yield f"      - name: {target.name}"
        yield f"        duration: {duration + 0.005:.2f}"
        yield f"        hold: {target.hold:g}"
        if pitch is not None:
            yield f"        pitch: [{max(-180.0, pitch[i, 0]):.0f}, {min(180.0, pitch[i, 1]):.0f}]"
            if i >= len(REACHES) - 1:
                yield "        balanced: true"
        moved = [j for j, angle in enumerate(goal) if before is None or angle != before[j]]
        named = [f"{robot.joints[j]}: {goal[j]:g}" for j in moved]
        yield "        joints: {"
        yield from (f"          {', '.join(named[k : k + _COLUMNS])}," for k in range(0, len(named), _COLUMNS))
        yield "        }"
        before = goal
