"""Figures 5.2, 5.3: how long messages take between ROS and the robot's joints, segment by segment."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import bifrost
from valor.analysis import pathway_plots
from valor.analysis.bag import Bag
from valor.analysis.pathways import (
    CONTROLLER,
    JOINT_STATES,
    MODE_COMMAND,
    MODE_REPORT,
    REFERENCE,
    VEC,
    Latencies,
    Segment,
)
from valor.analysis.results import Measure, Table
from valor.common.behaviors import ControlMode
from valor.common.instance import Recording
from valor.common.topics import JOINT_SETPOINTS, MOTION_STATE, MOTOR, PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.valorctl.experiments.experiment import Run
from valor.valorctl.node import join

if TYPE_CHECKING:
    from valor.valorctl.ros_client import RosClient

MODES = (
    ControlMode.STAND_MANIPULATE,
    ControlMode.STAND,
)  # commanded in turn; the last of an even number frees the arms again
RATE = 250.0  # of the controller's state: every update [Hz]
COMMANDS, QUICK_COMMANDS = 40, 2
CHANGES, QUICK_CHANGES = 40, 2
POINTS, INTERVAL = 3, 0.4  # of each motion; between them [s]
SWING = 0.15  # from where the arm is, at most [rad]
REST = 0.7  # between two motions or mode changes [robot time, s]
PATIENCE = 20.0  # [s]
TOPICS = (
    *(f"/bifrost/{topic.name}" for topic in (PROPRIOCEPTOR, MOTOR, MOTION_STATE, JOINT_SETPOINTS)),
    REFERENCE, VEC, JOINT_STATES, MODE_COMMAND, MODE_REPORT,
)  # fmt: skip
_THESIS = {"mode change": "49", "proprioception": "40", "joint command": "335"}
_WHY = {
    "mode change": "the same messages; each wakes who waits for it, where threads slept between two looks there",
    "proprioception": "the same conversion; each Proprioceptor wakes the VRC, whose threads slept between looks there",
    "joint command": "most of it was the real Motion System's and the arm's; simulated servos answer within tens of ms",
}
_NOTES = {
    "Reference → VEC": "by stamps; the VRC updates at 250 Hz",
    "VEC → MSetpoint": "by stamps; the whole update of the VRC is in it",
    "VEC → Motor": "by cross-correlation; the Motion System extrapolates set-points, so that hardly a delay is left",
    "Motor → HDT Cmd.": "by stamps: Proprioceptor says which Motor is obeyed; a control period, and the plant's delay",
    "HDT Cmd. → Prop.": "by cross-correlation; below zero where feed-forward is a period ahead of the set-point",
    "Prop. → JS": "by stamps; no polling: the VRC is woken by what comes",
    "Mode change cmd.": "by stamps, to the first MotionState of the new behavior",
    "Mode change reported": "by stamps, from that MotionState to the VRC's report",
}


def run(run: Run) -> None:
    """Command motions and mode changes, with the plant as the model has it and with the profile's imperfections."""
    profiles = [run.options.actuators] if run.options.quick else list(dict.fromkeys(["ideal", run.options.actuators]))
    found: dict[str, Latencies] = {}
    for profile in profiles:
        bag = run.out / f"pathway_latency_{profile}.mcap"
        robot = _record(run, bag, profile)
        run.progress.waiting("computing latencies")
        found[profile] = Latencies.of(Bag(bag), robot)
        run.files.append(bag)
    run.text = (
        f"The right arm is given {QUICK_COMMANDS if run.options.quick else COMMANDS} short trajectories of "
        f"{POINTS} random points each as JointTrajectory messages, and the VRC "
        f"{QUICK_CHANGES if run.options.quick else CHANGES} mode changes between {MODES[0]} and {MODES[1]}, all over "
        "ROS topics; latencies are computed from the bag alone. Each is from when a message was sent to when the next "
        "of the pathway was: by their stamps where they name one another, else by the shift of the largest "
        "cross-correlation of the joints' positions, one a motion and joint."
    )
    if len(profiles) > 1:
        run.text += (
            " Once with a plant that is the controller's model (ideal), once with the actuators' imperfections "
            f"({profiles[-1]})."
        )
    for profile, latencies in found.items():
        run.tables.append(_table(profile, latencies))
    for profile, latencies in found.items():
        for pathway in latencies.pathways:
            run.measures.append(
                Measure(f"{pathway.name}, {profile}", _ms(pathway.mean), "ms", _THESIS[pathway.name],
                        f"{1e3 * pathway.median:.1f} by medians; {_WHY[pathway.name]}")
            )  # fmt: skip
    run.files.append(_write_csv(found, run.out / "pathway_latency.csv"))
    run.picture([pathway_plots.bars(found, run.out / "pathway_latency_segments.png")],
                "Mean latency of each segment; the lines are one standard deviation.", "Figure 5.2")  # fmt: skip
    run.picture([pathway_plots.sums(found, _THESIS, run.out / "pathway_latency_pathways.png")],
                "The segments of each pathway, one behind the other.", "Figure 5.3")  # fmt: skip
    run.picture([pathway_plots.over_time(found, run.out / "pathway_latency_over_time.png")],
                "Every latency when it was met; below, what the Motion System did.")  # fmt: skip


# --- the live part --------------------------------------------------------------------------------------------------


def _record(run: Run, bag: Path, profile: str) -> RobotDescription:
    """Bring a system up, command it, take it down; the bag is complete then."""
    from trajectory_msgs.msg import JointTrajectory
    from vigir_humanoid_control_msgs.msg import ControlModeStatus, VigirControlModeCommand

    from valor.valorctl.ros_client import RosClient

    quick = run.options.quick
    rng = np.random.default_rng(run.options.seed)
    with run.system(bag=bag, actuators=profile, recording=Recording(only=TOPICS)) as settings:
        robot = RobotDescription.load(settings.robot)
        with join(run.instance, "experiment") as node, RosClient(run.instance, run.interruption.check) as ros:
            time_passes = _RobotTime(node, ros)
            told: list[str] = []
            ros.subscribe(ControlModeStatus, MODE_REPORT, lambda report: told.append(report.current_control_mode), 10)
            # The VRC listens, and the recorder.
            modes = ros.publisher(VigirControlModeCommand, MODE_COMMAND, 2)
            arm = ros.publisher(JointTrajectory, REFERENCE, 2)
            ros.set_parameter("valor_ros_controller", f"{CONTROLLER.rpartition('/')[2]}.state_publish_rate", RATE)
            changes = QUICK_CHANGES if quick else CHANGES
            for i in range(changes + 1):  # the last one frees the arm
                mode = MODES[i % 2]
                run.progress.waiting(f"mode change {i + 1} of {changes + 1}")
                told.clear()
                modes.publish(VigirControlModeCommand(requested_control_mode=mode))
                ros.wait(lambda mode=mode: mode in told, PATIENCE, f"control mode {mode} is not reported")  # type: ignore[misc]
                time_passes.rest(REST)
            run.progress.done(f"{profile}: {changes} mode changes")
            joints = robot.tables.group("right_arm")
            home = np.array([robot.nominal_posture[robot.index[joint]] for joint in joints])
            commands = QUICK_COMMANDS if quick else COMMANDS
            for i in range(commands):
                run.progress.waiting(f"motion {i + 1} of {commands}")
                if i and i % 10 == 0:
                    run.progress.done(f"{profile}: {i} of {commands} motions")
                targets = [*(home + rng.uniform(-SWING, SWING, (POINTS - 1, len(joints)))), home]
                arm.publish(_trajectory(joints, targets))
                time_passes.rest(POINTS * INTERVAL + REST)
    run.progress.done(f"{profile}: {commands} motions")
    return robot


def _trajectory(joints: Sequence[str], targets: Sequence[np.typing.NDArray[np.float64]]) -> object:
    """A JointTrajectory that rests for a moment at each target [rad]."""
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    points = []
    for i, target in enumerate(targets, 1):
        whole, part = divmod(i * INTERVAL, 1.0)
        at = Duration(sec=int(whole), nanosec=round(1e9 * part))
        zeros = [0.0] * len(joints)
        points.append(
            JointTrajectoryPoint(positions=target.tolist(), velocities=zeros, accelerations=zeros, time_from_start=at)
        )
    return JointTrajectory(joint_names=list(joints), points=points)


class _RobotTime:
    """Waits in robot time, which a busy computer slows down, while the ROS client hears what comes."""

    def __init__(self, node: bifrost.Node, ros: RosClient) -> None:
        self._measured = PROPRIOCEPTOR.subscriber(node)
        self._ros = ros
        self._now = 0

    def rest(self, seconds: float) -> None:
        """Return when so long has passed."""
        self._ros.wait(self._heard, PATIENCE, f"comms_manager is silent: no {PROPRIOCEPTOR.name}")
        end = self._now + round(1e9 * seconds)
        self._ros.wait(
            lambda: self._heard() and self._now >= end, PATIENCE, f"{seconds:g} s of robot time did not pass"
        )

    def _heard(self) -> bool:
        received = self._measured.latest()
        if received is not None:
            self._now = received.message.time
        return received is not None


# --- what comes of it -----------------------------------------------------------------------------------------------


def _ms(seconds: float) -> float | None:
    return 1e3 * seconds if np.isfinite(seconds) else None


def _table(profile: str, latencies: Latencies) -> Table:
    columns = ["segment", "mean", "sd", "median", "samples", "by correlation", "sd", "samples", "how"]
    return Table(f"Segments, {profile} [ms]", columns, [_row(segment) for segment in latencies.segments])


def _row(segment: Segment) -> list[str]:
    row = [segment.name]
    for samples, has_median in ((segment.samples, True), (segment.by_correlation, False)):
        values = [samples.mean(), samples.std(), np.median(samples)] if len(samples) else []
        shown = [f"{1e3 * value:.2f}" for value in (values if has_median else values[:2])]
        row += (shown or ["–"] * (3 if has_median else 2)) + [str(len(samples))]
    return [*row, _NOTES[segment.name]]


def _write_csv(found: Mapping[str, Latencies], file: Path) -> Path:
    with open(file, "w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(("actuators", "segment", "method", "sample", "latency_ms"))
        for profile, latencies in found.items():
            for segment in latencies.segments:
                for method, samples in (("stamps", segment.by_stamps), ("correlation", segment.by_correlation)):
                    writer.writerows(
                        (profile, segment.name, method, i, f"{1e3 * value:.4f}") for i, value in enumerate(samples)
                    )
    return file
