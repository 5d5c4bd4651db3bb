"""Figures 5.4–5.6: neck yaw and right arm, from goal to encoder."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from thesis.analysis.joint_signals import JointSignals, Quantity, draw, neck
from thesis.analysis.timeline import Timeline
from thesis.experiments import arm_session
from thesis.experiments.experiment import Run
from thesis.report.results import Measure, Table
from valor.analysis.reading.bag import Bag
from valor.analysis.reading.recording import Recording


def run(run: Run) -> None:
    """Move neck and right arm, and compare goal, set-point, command and measurement of each joint."""
    look, arm, timeline = _session(run, "tracking", "", None)
    run.text = (
        f"Neck and right arm move between predefined configurations in control mode {arm_session.MODE}. For every "
        "joint: the goals that clients gave, the set-points that the VRC made of them, what the Motion System "
        "commanded the motor, and what the encoder measured."
    )
    finals = [abs(one.final_error(timeline)) for one in arm]
    responses = [one.response for one in arm]
    run.measures += [
        *([Measure("neck yaw at rest from its goal", abs(look.final_error(timeline)), "rad")] if look else []),
        Measure("arm joint at rest from its goal, largest", max(finals), "rad", "near 0 (simulation)",
                "the same: joints reach what they are asked for"),
        Measure("arm joint from its set-point, largest", max(one.largest_error() for one in arm), "rad"),
        Measure("arm joint speed from its set-point's, largest", max(one.largest_error("velocity") for one in arm),
                "rad/s"),
        Measure("encoder after motor command, mean",
                float(np.mean([1e3 * each.seconds for each in responses if each])) if any(responses) else None, "ms",
                "", "by cross-correlation, over the arm's joints"),
    ]  # fmt: skip
    profile = None if run.options.quick else arm_session.real_arms(run)
    if profile:
        folder = arm_session.variant(run.options.robot, arm_session.PD, run.out / f"{Path(run.options.robot).name}_pd")
        _, real, then = _session(run, "real_arms", ", with the real robot's arms", profile, folder)
        _, lifted, last = _session(
            run, "gravity_offset", ", with gravity_offset", profile, folder, controller="gravity_offset"
        )
        run.text += (
            f" A second time with the arms as they were: actuators {profile} with friction, play, and a right wrist "
            "yaw that hardly turns, whatever its command; and the thesis' untuned PD control without gravity "
            "compensation (arm_control pd). A third time so, with the VRC's controller gravity_offset."
        )
        _compare(
            run, {"compensated": (arm, timeline), "pd, real arms": (real, then), "pd, gravity_offset": (lifted, last)}
        )
        *others, wrist = (abs(one.final_error(then)) for one in real)
        turned = np.abs(real[-1].command["velocity"].value).max()
        run.measures += [
            Measure("real arms: wrist yaw at rest from its goal", wrist, "rad", "does not turn (hardware)",
                    "the same, by a drive that hardly moves (actuators drc_finals)"),
            Measure("real arms: wrist yaw's velocity command, largest", float(turned), "rad/s", "high, constant",
                    "the same, by PD control: it is proportional to an error that stays"),
            Measure("real arms: another joint at rest from its goal, largest", max(others), "rad",
                    "persistent (hardware)", "the same: play, and weight that PD control does not compensate"),
        ]  # fmt: skip


def _compare(run: Run, series: dict[str, tuple[list[JointSignals], Timeline]]) -> None:
    """Add a table of the joints' largest offsets at rest, of each series."""
    rows = [
        [joints[0].joint, *(f"{1e3 * one.final_error(timeline):+.0f}"
                            for one, (_, timeline) in zip(joints, series.values(), strict=True))]
        for joints in zip(*(signals for signals, _ in series.values()), strict=True)
    ]  # fmt: skip
    run.tables.append(Table("Steady offset from the goal, largest [mrad]", ["joint", *series], rows))


def _session(
    run: Run, name: str, suffix: str, actuators: str | None, folder: Path | None = None, *, controller: str = ""
) -> tuple[JointSignals | None, list[JointSignals], Timeline]:
    """Record the motions; save plots and CSV. Returns signals of neck yaw, if any, and arm, and the motions."""
    bag = run.out / f"{name}.mcap"
    session = arm_session.record(run, bag, folder, actuators, controller=controller)
    timeline, robot = session.presets, session.robot
    run.progress.waiting("reading the joints' signals")
    recording = Recording(Bag(bag), robot)
    yaw = robot.tables.group(arm_session.NECK)[:1]
    look = JointSignals.of(recording, timeline, yaw[0]) if yaw else None
    arm = [JointSignals.of(recording, timeline, joint) for joint in robot.tables.group(arm_session.ARM)]
    signals = [look, *arm] if look else arm
    rows = []
    for one in signals:
        response = one.response
        rows.append([one.joint, f"{one.largest_error():.4f}", f"{one.final_error(timeline):+.4f}",
                     f"{1e3 * response.seconds:.1f}" if response else "–"])  # fmt: skip
    run.tables.append(
        Table(f"Joint by joint{suffix}", ["joint", "largest from set-point [rad]", "at rest from goal [rad]",
                                          "encoder after command [ms]"], rows)
    )  # fmt: skip
    run.files.append(_write_csv(signals, run.out / f"{name}.csv"))
    run.progress.waiting("drawing")
    if look and not suffix:
        run.picture([neck(recording, look, run.out / f"{name}_neck_yaw.png")], "Neck yaw.", "Figure 5.4")
    quantities: tuple[tuple[Quantity, str], ...] = (("position", "Figure 5.5"), ("velocity", "Figure 5.6"))
    for quantity, figure in quantities:
        file = run.out / f"{name}_right_arm_{quantity}.png"
        title = f"{'The real robot’s right' if suffix else 'Right'} arm: {quantity} of each joint"
        made = draw(recording, arm, quantity, title, file)
        run.picture([made], f"{quantity.capitalize()} of each joint of the right arm{suffix}.", figure)
    return look, arm, timeline


def _write_csv(signals: Sequence[JointSignals], file: Path) -> Path:
    """Write one row per sample and joint, resampled at the times of the encoders."""
    with open(file, "w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(("joint", "time_s", "goal_rad", "setpoint_rad", "command_rad", "measured_rad",
                         "setpoint_rad_s", "command_rad_s", "measured_rad_s"))  # fmt: skip
        for one in signals:
            at = one.measured["position"].time[::5]  # 100 Hz
            goal = one.reference[1][np.searchsorted(one.reference[0], at)]
            columns = [at, goal]
            for quantity in ("position", "velocity"):
                columns += [part[quantity].resampled(at) for part in (one.setpoint, one.command, one.measured)]
            for row in zip(*columns, strict=True):
                writer.writerow((one.joint, *(f"{value:.5f}" for value in row)))
    return file
