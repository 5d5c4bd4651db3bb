"""Where the hands end: plant and Motion Manager in one process, goals from a seed, truth from the simulator afterwards.

``python -m benchmarks.hands [TRIAL…] [--goals N] [--seeds N] [--profile NAME…] [--load KG] [--side left|right|both]
[--worn] [--calibrate POSES]``
prints a table; ``--goals 4 --seeds 1`` is quick. Trials: ``joints`` (arms to random postures by set-points), ``poses``
(hands to random poses in odom, in front, at the side and behind; errors are of those that are told to be reached, and
states count all),
``walk`` (a pose in odom that the robot walks past at 0.3 m/s).
Errors are of the true hand in the world from the goal; odom is where the soles
stood when the estimate began. ``--off`` is without compensation of the arms' servos, and what it is compared with.
``--worn`` draws play, friction and masses of the arms from the seed (``harness.worn_arms``); ``--calibrate POSES`` does
every trial again with the arms calibrated, as ``valorctl calibrate arm`` does. "On the way" the hand is compared with
where the joints' set-points have it.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

from bifrost import Received
from harness.closed_loop import load_robot
from harness.manipulating_robot import ManipulatingRobot
from harness.worn_arms import WORN, calibrated
from harness.worn_arms import worn as wear_out
from thesis.experiments.arm_goals import ArmGoals
from valor.calibration.identify import Found, identify
from valor.calibration.poses import Poses
from valor.calibration.record import Recorder
from valor.common import rotation
from valor.common.arrays import FloatArray
from valor.common.behaviors import Behavior
from valor.common.messages import Motor, VelocityCommand
from valor.motion_manager.handlers.motion import VelocityHandler
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot.tables import Side

REST = 0.3  # in a pose [s]


def calibrate(bench: ManipulatingRobot, group: str, poses: int) -> Found:
    """Bring an arm through poses and back, and find what it is; sensors and commands alone are looked at."""
    robot, parts = bench.robot, bench.manager.components
    chooser = Poses(full_model(robot, "collision"), group, parts.reference.position)
    arm = robot.group_indices(group)
    recorder = Recorder(robot)
    motors: dict[int, Motor] = {}

    def listen() -> None:
        motors[bench.motor.sequence] = bench.motor
        acting = motors.get(bench.measured.motor_sequence)
        if acting is not None and parts.state is not None:
            recorder.add(bench.measured, acting, parts.state.pelvis_orientation_in_odom)

    bench.each = listen
    for _ in range(poses):
        bench.follow(arm, chooser.next())
        bench.run(REST)
    for goal in chooser.back(parts.reference.position[arm], poses):
        bench.follow(arm, goal)
    bench.each = None
    return identify(full_model(robot), group, recorder.record(), poses)


SIDES: tuple[Side, Side] = ("left", "right")
SETTLED = 5.0  # from a goal to what is measured [s]
MEASURED = 0.5  # over which it is [s]
LOOK = 10  # periods between looks on the way
SPEED = 0.3  # of the walk [m/s]


@dataclass
class Errors:
    """What was measured of one kind of trial, a number a goal or a moment."""

    hand: list[float] = field(default_factory=list)  # [m]
    turn: list[float] = field(default_factory=list)  # [rad]
    joints: list[float] = field(default_factory=list)  # [rad]
    way: list[float] = field(default_factory=list)  # hand while it moves, RMS of a motion [m]
    said: list[float] = field(default_factory=list)  # position error as the status has it, off from the truth [m]
    states: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    def note(self, bench: ManipulatingRobot, side: int, goal: tuple[FloatArray, FloatArray]) -> None:
        """A hand, now."""
        position, turn = bench.hand(side)
        self.hand.append(float(np.linalg.norm(position - goal[0])))
        self.turn.append(float(np.linalg.norm(rotation.rotation_vector(goal[1] @ turn.T))))

    def worst_of(self, others: Errors) -> None:
        """One number of a moment's, the worst."""
        self.hand.append(max(others.hand))
        self.turn.append(max(others.turn))


def joints(bench: ManipulatingRobot, goals: ArmGoals, sides: tuple[int, ...], count: int, errors: Errors) -> None:
    """Arms to random postures by set-points; the hand from where the goal has it on the base as it was at first."""
    base = bench.plant.data.qpos[:7].copy()
    model, data = bench.plant.model, mujoco.MjData(bench.plant.model.mj)
    for _ in range(count):
        drawn = [goals.draw(SIDES[side], bench.plant.joint_position).joints for side in sides]
        arms = np.concatenate([bench.robot.group_indices(f"{SIDES[side]}_arm") for side in sides])
        wanted = np.concatenate(drawn)
        with lag(bench, arms, sides) as lags:
            bench.follow(arms, wanted)
        errors.way.append(float(np.sqrt(np.mean(np.square(lags)))))
        bench.run(SETTLED - 2.0)
        data.qpos[:] = bench.plant.data.qpos
        data.qpos[:7] = base
        data.qpos[np.arange(model.mj.nq)[model.qpos][arms]] = wanted
        mujoco.mj_kinematics(model.mj, data)
        off = np.abs(bench.plant.joint_position[arms] - wanted)
        errors.joints.append(float(off.max()))
        for side in sides:
            site = bench.sites[side]
            errors.hand.append(float(np.linalg.norm(bench.plant.data.site_xpos[site] - data.site_xpos[site])))
            turn = data.site_xmat[site].reshape(3, 3) @ bench.plant.data.site_xmat[site].reshape(3, 3).T
            errors.turn.append(float(np.linalg.norm(rotation.rotation_vector(turn))))


@contextmanager
def lag(bench: ManipulatingRobot, arms: npt.NDArray[np.intp], sides: tuple[int, ...]) -> Iterator[list[float]]:
    """How far hands are from where the set-points have them on the base as it is, now and then [m]."""
    model, data = bench.plant.model, mujoco.MjData(bench.plant.model.mj)
    places = np.arange(model.mj.nq)[model.qpos][arms]
    reference = bench.manager.components.reference
    lags: list[float] = []
    periods = itertools.count()

    def look() -> None:
        if next(periods) % LOOK == 0:
            data.qpos[:] = bench.plant.data.qpos
            data.qpos[places] = reference.position[arms]
            mujoco.mj_kinematics(model.mj, data)
            off = (data.site_xpos[site] - bench.plant.data.site_xpos[site] for site in (bench.sites[s] for s in sides))
            lags.append(max(float(np.linalg.norm(each)) for each in off))

    bench.each = look
    yield lags
    bench.each = None


def poses(bench: ManipulatingRobot, goals: ArmGoals, sides: tuple[int, ...], count: int, errors: Errors) -> None:
    """Hands to random poses in odom, held for a while."""
    for _ in range(count):
        drawn = {side: goals.draw(SIDES[side], bench.plant.joint_position) for side in sides}
        wanted = {side: bench.in_odom(goal.position, goal.rotation) for side, goal in drawn.items()}
        for side, goal in wanted.items():
            bench.send(side, *goal)
        goals_of = bench.manager.components.hand_goals
        bench.run(1.0)
        bench.run_until(lambda: all(goals_of.status(side, 0).state != "moving" for side in sides), 12.0)  # noqa: B023
        bench.run(1.0)
        over: dict[int, Errors] = {side: Errors() for side in sides}
        for _ in range(round(MEASURED / bench.robot.control_period)):
            bench.step()
            for side, goal in wanted.items():
                over[side].note(bench, side, goal)
        for side in sides:
            status = bench.manager.components.hand_goals.status(side, 0)
            errors.states.append(status.state)
            errors.said.append(abs(over[side].hand[-1] - status.position_error))
            if status.state == "reached":
                errors.worst_of(over[side])


def before(bench: ManipulatingRobot, side: int, ahead: float) -> tuple[FloatArray, FloatArray]:
    """A pose in odom so far before a hand's shoulder, as the forward preset holds it."""
    return bench.in_odom(np.array((ahead, 0.28 * (1 - 2 * side), 0.2)), np.eye(3))


def walk(bench: ManipulatingRobot, goals: ArmGoals, sides: tuple[int, ...], count: int, errors: Errors) -> None:
    """A hand stays where it is in odom while the robot walks at 0.3 m/s, until it is beside the pelvis."""
    for k in range(count):
        side = sides[k % len(sides)]
        for behavior in (Behavior.STAND, Behavior.WALK, Behavior.WALK_MANIPULATE):
            assert not bench.ask(behavior)
            bench.step()
        goal = before(bench, side, 0.55)
        bench.send(side, *goal)
        bench.run(SETTLED)
        start = bench.plant.data.qpos[0]
        while bench.plant.data.qpos[0] < start + 0.4 and bench.behavior is not Behavior.FALL:
            ask_to_walk(bench)
            bench.step()
            if bench.plant.data.qpos[0] > start + 0.03:
                errors.note(bench, side, goal)
        rest(bench, errors)


def ask_to_walk(bench: ManipulatingRobot) -> None:
    """Once more."""
    command = VelocityCommand(bench.manager.time, SPEED, 0.0, 0.0)
    VelocityHandler(bench.manager.components).handle(Received(command, 0, 1, "benchmark"), bench.manager.time)


def rest(bench: ManipulatingRobot, errors: Errors) -> None:
    """Come to rest, and manipulate."""
    if bench.behavior is Behavior.FALL:
        errors.failures.append(bench.manager.fsm.reason)
        raise SystemExit(bench.manager.fsm.reason)
    for side in range(2):
        bench.manager.components.hand_goals.release(side, "over")
    for behavior in (Behavior.WALK, Behavior.STAND):
        assert not bench.ask(behavior)
        bench.run(3.0)
    assert not bench.ask(Behavior.STAND_MANIPULATE)
    bench.run(1.0)


TRIALS: dict[str, Callable[[ManipulatingRobot, ArmGoals, tuple[int, ...], int, Errors], None]] = {
    "joints": joints,
    "poses": poses,
    "walk": walk,
}


def _row(values: list[float], scale: float) -> str:
    if not values:
        return "–"
    a = scale * np.array(values)
    return f"{np.sqrt(np.mean(a * a)):.1f}, {np.median(a):.1f}, {np.percentile(a, 90):.1f}, {a.max():.1f}"


@contextmanager
def arms(
    robot: RobotDescription, profile: str, seed: int, *, worn: bool, poses: int, sides: tuple[int, ...]
) -> Iterator[tuple[RobotDescription, str]]:
    """The robot as a trial has it, and its actuator profile: its arms worn, or not; calibrated, or not."""
    if worn:
        robot, profile = wear_out(robot, profile, seed), WORN
    if not poses:
        yield robot, profile
        return
    bench = ManipulatingRobot(robot, profile, seed)
    found = {f"{SIDES[side]}_arm": calibrate(bench, f"{SIDES[side]}_arm", poses).table for side in sides}
    with tempfile.TemporaryDirectory(prefix="valor-") as folder:
        yield calibrated(robot, found, Path(folder) / robot.name), profile


def table(arguments: argparse.Namespace) -> Iterator[str]:
    """Rows."""
    robot = load_robot(arguments.robot, arm_servos={"compensation": not arguments.off})
    sides = {"left": (0,), "right": (1,), "both": (0, 1)}[arguments.side]
    yield "RMS, median, 90 %, largest\n"
    columns = (
        "trial",
        "actuators",
        "arm",
        "load [kg]",
        "hand [mm]",
        "turned [mrad]",
        "joint [mrad]",
        "on the way [mm]",
        "said − true [mm]",
    )
    yield f"| {' | '.join(columns)} | states | falls |"
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    for profile in arguments.profile:
        for trial, poses in itertools.product(
            arguments.trials or TRIALS, (0, arguments.calibrate)[: 1 + bool(arguments.calibrate)]
        ):
            errors = Errors()
            plant = ", ".join([profile, *["worn"] * arguments.worn, *[f"calibrated by {poses} poses"] * bool(poses)])
            for seed in range(arguments.first, arguments.first + arguments.seeds):
                print(f"{trial}, {plant}, seed {seed}", file=sys.stderr, flush=True)
                with arms(robot, profile, seed, worn=arguments.worn, poses=poses, sides=sides) as (mine, actuators):
                    bench = ManipulatingRobot(mine, actuators, seed, arguments.load)
                    TRIALS[trial](bench, ArmGoals(mine, seed), sides, arguments.goals, errors)
            states = ", ".join(f"{errors.states.count(each)} {each}" for each in sorted(set(errors.states)))
            cells = (
                trial, plant, arguments.side, f"{arguments.load:g}", _row(errors.hand, 1e3), _row(errors.turn, 1e3),
                _row(errors.joints, 1e3), _row(errors.way, 1e3), _row(errors.said, 1e3), states,
                f"{len(errors.failures)}",
            )  # fmt: skip
            yield f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("trials", nargs="*", choices=[*TRIALS, []])
    parser.add_argument("--goals", type=int, default=30)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--profile", nargs="+", default=["hardware", "hdt_arms"])
    parser.add_argument("--load", type=float, default=0.0)
    parser.add_argument("--side", choices=("left", "right", "both"), default="right")
    parser.add_argument("--off", action="store_true", help="without compensation of the arms' servos")
    parser.add_argument("--worn", action="store_true", help="with arms that are not as their table says")
    parser.add_argument("--calibrate", type=int, default=0, metavar="POSES", help="also calibrated, by so many poses")
    parser.add_argument("--robot", default="escher")
    for row in table(parser.parse_args()):
        print(row, flush=True)


if __name__ == "__main__":
    main()
