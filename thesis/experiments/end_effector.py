"""Figures 5.7–5.15: pose of the hand, on a fixed base as clients assume, and on the floating base.

First as in the thesis, whose controller keeps the center of mass in place, so that the torso shifts: with arms that
reach their goals, and with the arms of the real robot. Then with this system's settings, in which the center of mass
follows the arm as far as the feet allow.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from thesis.analysis import hand_goals
from thesis.analysis.end_effector import HandTrack
from thesis.analysis.hand_goals import Arrival
from thesis.experiments import arm_session, arrivals
from thesis.experiments.arbitrary_goals import HAND, SIDE
from thesis.experiments.experiment import Run
from thesis.report.results import Measure, Table
from valor.analysis.reading.bag import Bag
from valor.analysis.reading.recording import Recording
from valor.common.arrays import FloatArray
from valor.common.topics import (
    GROUND_TRUTH,
    HAND_GOAL,
    HAND_GOAL_STATUS,
    JOINT_SETPOINTS,
    MOTION_STATE,
    PROPRIOCEPTOR,
)

READ = (PROPRIOCEPTOR, MOTION_STATE, JOINT_SETPOINTS, GROUND_TRUTH, HAND_GOAL, HAND_GOAL_STATUS)
# The center of mass stays in place.
THESIS: dict[str, dict[str, Any]] = {"whole_body": {"com_shift_limit": 0.0}, **arm_session.UNCOMPENSATED}


SEEN = "Solid: as measured; pale: the goal's arm on a base that stays; line: the hand's way there."


def run(run: Run) -> None:
    """Move the right arm to predefined configurations: as in the thesis, with its arms, and as this system does."""
    folder = arm_session.variant(run.options.robot, THESIS, run.out / f"{Path(run.options.robot).name}_thesis")
    profile = arm_session.real_arms(run)
    sessions = {
        arrivals.KEPT: _session(run, run.out / "end_effector.mcap", folder, "postures"),
        arrivals.OURS: _session(run, run.out / "end_effector_compensated.mcap", None, "poses"),
    }
    if profile:
        sessions[arrivals.REAL] = _session(run, run.out / "end_effector_real_arms.mcap", folder, "postures", profile)
    kept, ours = sessions[arrivals.KEPT].track, sessions[arrivals.OURS].track
    real = sessions.get(arrivals.REAL)
    run.text = (
        f"The right arm goes through the configurations {', '.join(_names(kept))} in "
        f"control mode {arm_session.MODE}. Poses are of the gripper's frame, by forward kinematics. Fixed base: the "
        "torso is taken to stay, as clients do. Floating base: it is where the estimator says. As in the thesis, the "
        "Whole-Body Controller keeps the center of mass where it is (com_shift_limit 0), and nothing compensates for "
        "what the torso does; a second run shows this system's own way, in which the center of mass goes with the arm."
    )
    if real:
        run.text += (
            f" A third one has the thesis' way with the arms as they were (actuators {profile}): harmonic drives with "
            "friction, 7 cm of play at the gripper of the stretched arm, no gravity compensation, and a right wrist "
            "yaw that hardly turns. Nothing makes up for these (arm_servos: compensation false)."
        )
    run.tables += [_table("As in the thesis: at rest after each motion [cm]", kept),
                   _table("This system's own way [cm]", ours)]  # fmt: skip
    if real:
        run.tables.append(_table("As in the thesis, with the real robot's arms [cm]", real.track))
    _measure(run, kept, ours, real.track if real else None)
    arrivals.tell(run, {way: each.arrivals for way, each in sessions.items()},
                  {way: each.refused for way, each in sessions.items()})  # fmt: skip
    run.files += [_write_csv(kept, run.out / "end_effector.csv"),
                  _write_csv(ours, run.out / "end_effector_compensated.csv")]  # fmt: skip
    if real:
        run.files.append(_write_csv(real.track, run.out / "end_effector_real_arms.csv"))
    _draw(run, sessions[arrivals.KEPT], ours)
    if real:
        _draw_real(run, real)


def _draw(run: Run, session: _Session, ours: HandTrack) -> None:
    """Figures 5.7 to 5.12."""
    from thesis.analysis import end_effector_plots as plots

    kept = session.track
    run.progress.waiting("drawing")
    for error, name, title, subtitle, figure in (
        (kept.command_error, "command", "What the VRC still has to go", "its set-points from the goal, fixed base",
         "Figure 5.8"),
        (kept.tracking_error, "tracking", "How the robot follows the VRC", "measured from its set-points, fixed base",
         "Figure 5.9"),
        (kept.total_error, "total", "How far the hand is from its goal", "measured, floating base, from the goal",
         "Figure 5.11"),
    ):  # fmt: skip
        made, axes = plots.errors(kept, error, title, subtitle, run.out / f"end_effector_{name}.png")
        run.picture([made], f"{title}: {subtitle}.{axes}", figure)
    run.picture([plots.base(kept, ours, run.out / "end_effector_base.png")],
                "The hand's pose with the base where it is, from that with the base where it was; and the same where "
                "the center of mass goes with the arm.", "Figure 5.12")  # fmt: skip
    run.picture([plots.torso(kept, run.out / "end_effector_torso.png")], "The torso's motion.")
    for name, fixed, figure in (("fixed", True, "Figure 5.7"), ("poses", False, "Figure 5.10")):
        made = plots.poses(session.recording, kept, _names(kept), run.out / f"end_effector_{name}.png", fixed=fixed)
        base = "where it was at first, as clients take it" if fixed else "where it is"
        run.picture([made], f"The robot at rest at each pose, its base {base}. {SEEN}", figure)


def _names(track: HandTrack) -> list[str]:
    """Names of the presets, each once."""
    return list(dict.fromkeys(motion.name for motion in track.motions))


def _draw_real(run: Run, session: _Session) -> None:
    """Figures 5.13 to 5.15."""
    from thesis.analysis import end_effector_plots as plots

    track = session.track
    run.picture([plots.poses(session.recording, track, _names(track), run.out / "real_arms_poses.png")],
                f"The robot at rest at each pose, with the real robot's arms, its base where it is. {SEEN}",
                "Figure 5.13")  # fmt: skip
    title, subtitle = "How the real robot's arms follow the VRC", "measured from its set-points, fixed base"
    made, axes = plots.errors(track, track.tracking_error, title, subtitle, run.out / "real_arms_tracking.png")
    run.picture([made], f"Errors that stay: play, weight, and a wrist that does not turn (yaw).{axes}", "Figure 5.14")
    run.picture([plots.shares(track, run.out / "real_arms_shares.png")],
                "How far the hand is from its goal (solid), and the floating base's part of it (dashed): components, "
                "and below them magnitudes.", "Figure 5.15")  # fmt: skip


@dataclass(frozen=True)
class _Session:
    """Motions of the hand in one system: to presets and to arbitrary goals."""

    track: HandTrack
    recording: Recording
    arrivals: list[Arrival]
    refused: list[str]


def _session(
    run: Run, bag: Path, folder: Path | None, goals: arm_session.Goals, actuators: str | None = None
) -> _Session:
    """Record the motions and compute the poses of the hand."""
    session = arm_session.record(run, bag, folder, actuators, goals)
    run.progress.waiting("computing the hand's poses")
    recording = Recording(Bag(bag), session.robot)
    recording.load(*(topic for topic in READ if recording.has(topic)))  # in one pass: it is long
    track = HandTrack.of(recording, session.presets, SIDE)
    there: list[Arrival] = []
    if session.arbitrary.motions:
        to_goals = HandTrack.of(recording, session.arbitrary, SIDE)
        led = goals == "poses"
        there = hand_goals.led_arrivals(to_goals, recording, HAND) if led else hand_goals.arrivals(to_goals)
    return _Session(track, recording, there, session.refused)


def _table(title: str, track: HandTrack) -> Table:
    rows = []
    for motion in track.motions:
        rest = track.settled(motion)
        shift = 100.0 * track.base_error.position[rest].mean(axis=0)
        distances = (track.base_error, track.total_error, track.tracking_error)
        rows.append([motion.name, *(f"{value:+.1f}" for value in shift),
                     *(f"{100.0 * each.distance[rest].mean():.1f}" for each in distances)])  # fmt: skip
    return Table(title, ["pose", "base x", "base y", "base z", "by the base", "from the goal", "from set-points"], rows)


def _measure(run: Run, kept: HandTrack, ours: HandTrack, real: HandTrack | None) -> None:
    """Add the measures that the thesis reports."""
    moved, total, turned = _at_rest(kept)
    away = np.array([motion.name != "home" for motion in kept.motions])
    run.measures += [
        Measure("command to sensed, largest", 100.0 * float(kept.tracking_error.distance.max()), "cm",
                "≤ 2 (simulation)", "on the way; larger where a busy computer sends set-points late"),
        Measure("command to sensed, 99 of 100 moments", 100.0 * float(np.quantile(kept.tracking_error.distance, 0.99)),
                "cm", "≤ 2 (simulation)", "the same size: what servos lag behind while they move"),
        Measure("by the floating base, smallest at a pose", 100.0 * float(moved[away].min()), "cm", "3",
                "the same cause: the center of mass stays, so the torso goes the other way than the arm"),
        Measure("by the floating base, largest at a pose", 100.0 * float(moved[away].max()), "cm", "6",
                "the same size; the thesis gives neither its poses nor its masses"),
        Measure("by the floating base, largest component",
                100.0 * float(np.abs(kept.base_error.position).max()), "cm", "5",
                "likewise, on the way included"),
        Measure("from the goal at rest, largest", 100.0 * float(total.max()), "cm"),
        _share("share of the base in it", moved[away], total[away], "",
               "near 1: the joints reach their goals, what is left is the base's"),
        Measure("orientation at rest, largest angle", float(np.rad2deg(turned.max())), "°", "converges to 0",
                "the same: the torso's orientation is held, so that it only shifts"),
        Measure("by the floating base where the CoM goes with the arm, largest at a pose",
                100.0 * float(_at_rest(ours)[0][away].max()), "cm", "", "this system's own way"),
    ]  # fmt: skip

    if real is None:
        return
    moved, total, _ = _at_rest(real)
    tracking = np.array([real.tracking_error.distance[real.settled(motion)].mean() for motion in real.motions])
    yaw = np.array([np.abs(real.tracking_error.orientation[real.settled(motion), 2]).mean() for motion in real.motions])
    away = np.array([motion.name != "home" for motion in real.motions])
    run.measures += [
        Measure("real arms: from set-points at rest, largest", 100.0 * float(tracking.max()), "cm",
                "large and persistent (hardware)", "the same: play and weight, without gravity compensation"),
        Measure("real arms: from the goal at rest, largest", 100.0 * float(total.max()), "cm", "10 (hardware)",
                "the same size; the play of 7 cm is the thesis', poses and friction are ours"),
        _share("real arms: share of the base in it", moved[away], total[away], "a little under ½ (hardware)",
               "distances do not add up where directions differ"),
        Measure("real arms: yaw at rest from set-points, largest", float(np.rad2deg(yaw.max())), "°",
                "large (hardware)", "the same: the wrist yaw, where a pose wants it turned"),
    ]  # fmt: skip


def _share(name: str, moved: FloatArray, total: FloatArray, thesis: str, why: str) -> Measure:
    """Errors due to the base over errors from the goal: their sums over the poses, and of single poses (n,) [m]."""
    single = moved / total
    note = f"sum over the poses by sum; of single poses {single.min():.2f}–{single.max():.2f}; {why}"
    return Measure(name, float(moved.sum() / total.sum()), "", thesis, note)


def _at_rest(track: HandTrack) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of each motion at rest: error due to the base, error from the goal [m], largest angle from the goal [rad]."""
    rests = [track.settled(motion) for motion in track.motions]
    base, total = track.base_error, track.total_error
    return (
        np.array([base.distance[rest].mean() for rest in rests]),
        np.array([total.distance[rest].mean() for rest in rests]),
        np.array([np.abs(total.orientation[rest]).max() for rest in rests]),
    )


def _write_csv(track: HandTrack, file: Path) -> Path:
    """Write all errors, one row per sample."""
    columns = {"command": track.command_error, "tracking": track.tracking_error, "total": track.total_error,
               "base": track.base_error}  # fmt: skip
    with open(file, "w", newline="") as out:
        writer = csv.writer(out)
        header = ["time_s", "behavior"]
        for name in columns:
            header += [f"{name}_{axis}_m" for axis in "xyz"] + [
                f"{name}_{turn}_rad" for turn in ("roll", "pitch", "yaw")
            ]
        writer.writerow(header)
        values = np.hstack([part for error in columns.values() for part in (error.position, error.orientation)])
        for at, behavior, row in zip(track.time, track.behavior, values, strict=True):
            writer.writerow([f"{at:.4f}", behavior, *(f"{value:.6f}" for value in row)])
    return file
