"""Search for the motions by which a robot gets up: the content of ``get_up.yaml``."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from valor.common.arrays import FloatArray
from valor.get_up_planning.motions import OnFeet, OnHandsAndKnees, OnKnees, RollOver, Squat, StandUp, Throw
from valor.get_up_planning.rollouts import Fallen, Rollouts, Target
from valor.get_up_planning.search import Report, Search, find, tuned, usable
from valor.robot.description import RobotDescription
from valor.robot.get_up_table import Posture, attitude

FALLS = 24  # towards each side
ONWARD = 3  # key poses of a rise that follow when a roll-over is simulated
CHECKED = (8, 32)  # falls from which a shorter motion succeeds as often: a few, then many
SHORTER = (0.0, 0.5, 0.75)  # share of a key pose's time
BENDS = (0.0, -0.2, -0.4)  # flexion of the knees added in the first key pose [rad]
SHORTEST = 0.1  # duration [s]
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
    falls, others = rollouts.fallen(range(FALLS)), rollouts.varied(rollouts.fallen(range(FALLS, 3 * FALLS)))

    def shorter(poses: Sequence[Target], start: Sequence[Posture | None], search: Search) -> list[Target]:
        starts = usable(others, start)

        def count(poses: Sequence[Target], first: int) -> int:
            return search.successes(starts[:first], poses).count(True)

        return shortened(poses, count, partial(rollouts.duration, poses[0].goal), report)

    lying = starts = usable(falls, (Posture.FACE,))
    rise = list[Target]()
    for kind in (Squat, StandUp) if Squat(rollouts).folds else (OnHandsAndKnees, OnKnees, OnFeet):
        search = kind(rollouts)
        part = find(search, starts, seed, report)
        if kind is OnFeet and (kneeling := _after(OnKnees(rollouts), usable(others, (Posture.FACE,)), rise)):
            part = tuned(Throw(rollouts, part), kneeling, seed, report)
        starts = _after(search, starts, part)
        rise += part
    rise = shorter(rise, (Posture.FACE,), search)
    over = RollOver(rollouts, rise[:ONWARD])
    roll = shorter(find(over, falls, seed, report), over.start, over)
    if kind is OnFeet:
        rise = freed(rollouts, rise, roll, others, report)
    return table(rollouts, lying, rise, roll)


def _after(search: Search, starts: Sequence[Fallen], part: Sequence[Target]) -> list[Fallen]:
    """Return the robots for which a part of a motion succeeds, after it."""
    return [
        Fallen(start.mj, states[-1], part[-1].goal, None)
        for start, states in zip(starts, search.play([(start, part) for start in starts]), strict=True)
        if search.succeeded(states)
    ]


def freed(
    rollouts: Rollouts, rise: Sequence[Target], roll: Sequence[Target], falls: Sequence[Fallen], report: Report
) -> list[Target]:
    """Return a rise over the knees that reaches them from most falls: with bent knees an arm may stay below the body.

    The flexion in its first key pose is one of ``BENDS`` more.
    """
    knees, over, count = OnKnees(rollouts), RollOver(rollouts), next(i for i, pose in enumerate(rise, 1) if pose.hold)
    starts = [*usable(falls, (Posture.FACE,)), *_after(over, usable(falls, over.start), roll)]
    first, *others = rise
    tried = [knees.bent(first, bend) for bend in BENDS]
    succeeded = [knees.successes(starts, [pose, *others[: count - 1]]).count(True) for pose in tried]
    for bend, often in zip(BENDS, succeeded, strict=True):
        report(f"{first.name}, knees {bend:+.1f} rad: {knees.to} from {often} of {len(starts)} falls")
    return [tried[int(np.argmax(succeeded))], *others]


def shortened(
    poses: Sequence[Target],
    count: Callable[[Sequence[Target], int], int],
    duration: Callable[[Sequence[Target]], float],
    report: Report,
) -> list[Target]:
    """Return a motion's key poses without those, and with less time for those, without which it succeeds as often.

    ``count`` returns how often a motion succeeds from the first falls, so many; ``duration``: of its moves [s].
    """
    poses, least = list(poses), [count(poses, falls) for falls in CHECKED]
    for share in SHORTER:
        i = 0
        while i < len(poses) - (not share):
            pose = poses[i]
            shorter = replace(pose, duration=max(share * pose.duration, SHORTEST))
            tried = [*poses[:i], *([shorter] if share else []), *poses[i + 1 :]]
            rests = pose.hold > 0.0 and i < len(poses) - 1
            useful = not rests and (not share or duration(tried) < duration(poses))  # limits of joints may bind
            if useful and all(count(tried, falls) >= known for falls, known in zip(CHECKED, least, strict=True)):
                poses = tried
                report(f"{pose.name}: {f'{1.0 - share:.0%} shorter' if share else 'left out'}")
                i += share > 0.0
            else:
                i += 1
    return poses


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
    balance = rollouts.balance
    yield f"balance: {{ joints: [{', '.join(balance.joints)}], gain: {balance.gain:g}, limit: {balance.limit:g} }}"
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
        goal = target.goal.round(3).clip(robot.lower, robot.upper) + 0.0  # no −0
        duration = target.duration if before is None else rollouts.move(before, target).duration
        yield f"      - name: {target.name}"
        yield f"        duration: {duration + 0.005:.2f}"
        yield f"        hold: {target.hold:g}"
        if pitch is not None:
            yield f"        pitch: [{max(-180.0, pitch[i, 0]):.0f}, {min(180.0, pitch[i, 1]):.0f}]"
            if target.balanced:
                yield "        balanced: true"
        moved = [j for j, angle in enumerate(goal) if before is None or angle != before[j]]
        named = [f"{robot.joints[j]}: {goal[j]:g}" for j in moved]
        yield "        joints: {"
        yield from (f"          {', '.join(named[k : k + _COLUMNS])}," for k in range(0, len(named), _COLUMNS))
        yield "        }"
        before = goal
