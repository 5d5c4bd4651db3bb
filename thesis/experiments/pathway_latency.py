"""Figures 5.2, 5.3: latencies between ROS and the robot's joints, by segment."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import bifrost
from thesis.analysis import pathway_plots, rates
from thesis.analysis.conversions import Conversion, conversions
from thesis.analysis.pathway_taps import ARM, CONTROLLER, MODE_COMMAND, MODE_REPORT, REFERENCE, TOPICS
from thesis.analysis.pathways import JOINT_COMMAND, Latencies, Segment
from thesis.experiments import ipc_latency
from thesis.experiments.experiment import Run
from thesis.report.results import Measure, Table
from valor.analysis.reading.bag import Bag
from valor.common.arrays import FloatArray
from valor.common.behaviors import ControlMode
from valor.common.errors import ValorError
from valor.common.instance import Recording, Settings
from valor.common.topics import PROPRIOCEPTOR
from valor.robot.description import RobotDescription
from valor.valorctl.drive.node import join

if TYPE_CHECKING:
    from valor.valorctl.drive.ros_client import RosClient

MODES = (
    ControlMode.STAND_MANIPULATE,
    ControlMode.STAND,
)  # commanded alternately; an even number ends in manipulation
RUNS = 3  # systems with the profile's imperfections, one after the other; one that is ideal
COMMANDS, QUICK_COMMANDS = 14, 2  # a run
CHANGES, QUICK_CHANGES = 14, 2
POINTS, INTERVAL = 3, 0.4  # of each motion; time between points [s]
SWING = 0.15  # maximum distance from the initial posture [rad]
FLOOR_RATE = 50.0  # of the doubles that the floor is measured with [Hz]
DOUBLES, QUICK_DOUBLES = 400, 25
REST = 0.7  # between two motions or mode changes [robot time, s]
PATIENCE = 20.0  # [s]
DISCOVERY = 60.0  # until VRC and recorder subscribe, while all processes start on busy cores [s]
VRC, VRC_RATE = "valor_ros_controller", "VRC's updates asked for at"
_THESIS = {"mode change": "49", "proprioception": "40", JOINT_COMMAND: "335"}
_WHY = {
    "mode change": "the same messages; each wakes who waits for it, where threads slept between two looks there",
    "proprioception": "the same conversion; each Proprioceptor wakes the VRC, whose threads slept between looks there",
    JOINT_COMMAND: "most of it was the real Motion System's and the arm's; simulated servos answer within tens of ms",
}
_TRANSPORTS = {"ros": "ROS 2", "bifrost": "Bifrost"}
_NOTES = {
    "Reference → VEC": "to the Proprioceptor that the first moving control values answer",
    "VEC → MSetpoint": "JointSetpoints name that Proprioceptor's time; the whole update of the VRC is in it",
    "VEC → Motor": "MotionState names the set-points that its Motor follows",
    "Prop. → JS": "joint states name the Proprioceptor's time; the VRC is woken by what comes",
    "Mode change cmd.": "to the first MotionState of the new behavior",
    "Mode change reported": "from that MotionState to the VRC's report",
}
_TO_PLANT = {
    True: {
        "Motor → HDT Cmd.": "HdtCommand names the Motor that it carries; each limb has a cycle of its own",
        "HDT Cmd. → Prop.": "HdtState names the command that acted; its positions are found in Proprioceptor",
    },
    False: {
        "Motor → HDT Cmd.": "no driver: until the period in which Proprioceptor says that the Motor is in force",
        "HDT Cmd. → Prop.": "that period, at whose end is measured",
    },
}


ABBREVIATIONS = (
    "Reference: a client's JointTrajectory; VEC (Valor Escher Controller): control values of the VRC; MSetpoint: the "
    "VRC's set-points for the Motion System (JointSetpoints); Motor: the Motion System's command of all joints; HDT "
    "Cmd.: the command that leaves for the arm's motor controllers; Prop. (Proprioceptor): what the Motion System "
    "measured; JS: joint states on ROS."
)


def run(run: Run) -> None:
    """Command motions and mode changes, with ideal actuators and with the imperfections of the profile."""
    profiles = [run.options.actuators] if run.options.quick else list(dict.fromkeys(["ideal", run.options.actuators]))
    runs: dict[str, list[Latencies]] = {profile: [] for profile in profiles}
    floors: dict[str, list[dict[str, FloatArray]]] = {profile: [] for profile in profiles}
    for number in range(1, 1 + (1 if run.options.quick else RUNS)):
        for profile in profiles if number == 1 else profiles[-1:]:
            bag = run.out / f"pathway_latency_{profile}_{number}.mcap"
            robot, floor = _record(run, bag, profile, number)
            run.progress.waiting("computing latencies")
            runs[profile].append(Latencies.of(Bag(bag), robot))
            floors[profile].append(floor)
            run.files.append(bag)
    found = {profile: Latencies.together(each) for profile, each in runs.items()}
    commands, changes = (QUICK_COMMANDS, QUICK_CHANGES) if run.options.quick else (COMMANDS, CHANGES)
    run.text = (
        f"In {len(runs[profiles[-1]])} systems, one after the other, the right arm is given {commands} short "
        f"trajectories of {POINTS} random points each as JointTrajectory messages, and the VRC {changes} mode changes "
        f"between {MODES[0]} and {MODES[1]}, all over ROS topics; latencies are computed from the bags alone. Each is "
        "from when a message was sent to when the next of the pathway was, by the stamps of messages that name one "
        "another. Beside it is the thesis' method: the shift of the largest cross-correlation of joints' positions, "
        "one a motion and joint. It tells how far a signal is behind, not how old what it was made of is: set-points "
        "are extrapolated to when they act, and joints are led by feed-forward, so that it can be less than the "
        "messages took, even below zero. What a conversion costs is at most the segment less what the transport takes "
        f"at least that its first message came by: doubles from process to process, {FLOOR_RATE:.0f} a second, in the "
        f"same system after the last motion. {ABBREVIATIONS}{_rates(run)}"
    )
    if len(profiles) > 1:
        run.text += (
            " Once with a plant that is the controller's model (ideal), once with the actuators' imperfections "
            f"({profiles[-1]}); the former in one system."
        )
    for profile, latencies in found.items():
        floor = {each: np.concatenate([one[each] for one in floors[profile]]) for each in floors[profile][0]}
        bounds = conversions(latencies, floor)
        run.tables += [_table(profile, latencies), _first(profile, latencies), _bounds(profile, bounds)]
        run.measures += _measures(profile, latencies, runs[profile])
        told = next(each for each in bounds if each.segment.name == "Prop. → JS")
        run.measures.append(
            Measure(f"conversion of states at most, {profile}", _ms(told.median), "ms", "39.8",
                    "the median less the quickest of Bifrost's doubles in the same runs")
        )  # fmt: skip
    run.files.append(_write_csv(found, run.out / "pathway_latency.csv"))
    run.picture([pathway_plots.bars(found, run.out / "pathway_latency_segments.png")],
                "Mean latency of each segment by stamps; the lines reach from the 5th to the 95th percentile, diamonds "
                "are medians, crosses means by correlation.", "Figure 5.2")  # fmt: skip
    run.picture([pathway_plots.sums(found, _THESIS, run.out / "pathway_latency_pathways.png")],
                "The segments' means of each pathway by stamps, one behind the other; the lines reach from the 5th to "
                "the 95th percentile of the sum of independent segments.", "Figure 5.3")  # fmt: skip
    run.picture([pathway_plots.over_time(found, run.out / "pathway_latency_over_time.png")],
                "Every latency when it was met, run after run; below, what the Motion System did.")  # fmt: skip


def _rates(run: Run) -> str:
    """What came of the rates asked for."""
    tick = run.settings.get(f"{rates.TICK} asked for at", "")
    came = ", ".join(f"{name} {value}" for name, value in rates.told(run.rates).items())
    return f" Asked for at {tick}, {came}; the VRC, and the joint states with it, at {run.settings[VRC_RATE]}."


def _measures(profile: str, latencies: Latencies, runs: Sequence[Latencies]) -> list[Measure]:
    """Means by stamps, of the joint command also by correlation and to the first milliradian; runs by themselves."""
    made = []
    for i, pathway in enumerate(latencies.pathways):
        note = f"by stamps; {1e3 * pathway.median:.1f} by medians; {_WHY[pathway.name]}"
        name, thesis = pathway.name, _THESIS[pathway.name]
        if name == JOINT_COMMAND:
            name, thesis = f"{name} by stamps", ""
        made.append(Measure(f"{name}, {profile}", _ms(pathway.mean), "ms", thesis,
                            f"{note}; {_each([one.pathways[i].mean for one in runs])}"))  # fmt: skip
    i, pathway = next((i, each) for i, each in enumerate(latencies.pathways) if each.name == JOINT_COMMAND)
    made += [
        Measure(f"{JOINT_COMMAND} by correlation, {profile}", _ms(pathway.behind), "ms", _THESIS[JOINT_COMMAND],
                f"the thesis' method, with the plant in it; {_each([one.pathways[i].behind for one in runs])}"),
        Measure(f"{JOINT_COMMAND} to the first milliradian, {profile}", _ms(_mean(latencies.first.measured)), "ms", "",
                "from a reference to when a joint is seen to move; "
                + _each([_mean(one.first.measured) for one in runs])),
    ]  # fmt: skip
    return made


def _each(values: Sequence[float]) -> str:
    """Means of runs [s], as text."""
    return f"runs: {', '.join(f'{1e3 * value:.1f}' for value in values)}"


def _mean(samples: FloatArray) -> float:
    return float(samples.mean()) if len(samples) else float("nan")


# --- recording --------------------------------------------------------------------------------------------------


def _record(run: Run, bag: Path, profile: str, number: int) -> tuple[RobotDescription, dict[str, FloatArray]]:
    """Start a system, command it, and stop it; the bag is then complete.

    Returns:
        The robot, and latencies of doubles in that system by transport [s].
    """
    from trajectory_msgs.msg import JointTrajectory
    from vigir_humanoid_control_msgs.msg import ControlModeStatus, VigirControlModeCommand

    from valor.valorctl.drive.ros_client import RosClient

    quick = run.options.quick
    rng = np.random.default_rng([run.options.seed, number])
    with run.system(bag=bag, actuators=profile, recording=Recording(only=TOPICS)) as settings:
        robot = RobotDescription.load(settings.robot)
        with join(run.instance, "experiment") as node, RosClient(run.instance, run.interruption.check) as ros:
            time_passes = _RobotTime(node, ros)
            told: list[str] = []
            ros.subscribe(ControlModeStatus, MODE_REPORT, lambda report: told.append(report.current_control_mode), 10)
            # Subscribers: VRC and recorder.
            modes = ros.publisher(VigirControlModeCommand, MODE_COMMAND, 2, DISCOVERY)
            arm = ros.publisher(JointTrajectory, REFERENCE, 2, DISCOVERY)
            rate = vrc_rate(ros, settings)
            run.note({VRC_RATE: f"{rate:g} Hz"})
            _set_parameter(ros, VRC, f"{CONTROLLER.rpartition('/')[2]}.state_publish_rate", rate)
            changes = QUICK_CHANGES if quick else CHANGES
            for i in range(changes + 1):  # the last one enables manipulation
                mode = MODES[i % 2]
                run.progress.waiting(f"mode change {i + 1} of {changes + 1}")
                told.clear()
                modes.publish(VigirControlModeCommand(requested_control_mode=mode))
                ros.wait(lambda mode=mode: mode in told, PATIENCE, f"control mode {mode} is not reported")  # type: ignore[misc]
                time_passes.rest(REST)
            run.progress.done(f"{profile}: {changes} mode changes")
            joints = robot.tables.group(ARM)
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
        floors = ipc_latency.measure(run, "processes", FLOOR_RATE, QUICK_DOUBLES if quick else DOUBLES)
    return robot, floors


def vrc_rate(ros: RosClient, settings: Settings) -> float:
    """Rate of the VRC's updates, a divisor of the control rate [Hz]."""
    from rcl_interfaces.srv import GetParameters

    client = ros.node.create_client(GetParameters, f"{VRC}/get_parameters")
    ros.wait(client.service_is_ready, PATIENCE, f"{VRC}: no service get_parameters")
    got = client.call_async(GetParameters.Request(names=["update_rate"]))
    ros.wait(got.done, PATIENCE, f"{VRC} does not tell its update_rate")
    control = RobotDescription.load(settings.robot, settings.control_rate).tables.control_rate
    return control / max(1, round(control / float(got.result().values[0].double_value)))


def _set_parameter(ros: RosClient, node: str, name: str, value: float) -> None:
    """Set a parameter of another node; raises ``ValorError`` with the reason if it is rejected."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    client = ros.node.create_client(SetParameters, f"{node}/set_parameters")
    ros.wait(client.service_is_ready, PATIENCE, f"{node}: no service set_parameters")
    setting = client.call_async(SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()]))
    ros.wait(setting.done, PATIENCE, f"{node} does not set {name}")
    result = setting.result().results[0]
    if not result.successful:
        raise ValorError(f"{node}: {name} = {value:g} rejected: {result.reason}")


def _trajectory(joints: Sequence[str], targets: Sequence[np.typing.NDArray[np.float64]]) -> object:
    """Make a JointTrajectory that rests at each target [rad]."""
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
    """Waiting in robot time while the ROS client processes messages."""

    def __init__(self, node: bifrost.Node, ros: RosClient) -> None:
        self._measured = PROPRIOCEPTOR.subscriber(node)
        self._ros = ros
        self._now = 0

    def rest(self, seconds: float) -> None:
        """Wait for some seconds of robot time."""
        self._ros.wait(self._heard, PATIENCE, f"comms_manager sends no {PROPRIOCEPTOR.name}")
        end = self._now + round(1e9 * seconds)
        self._ros.wait(
            lambda: self._heard() and self._now >= end, PATIENCE, f"{seconds:g} s of robot time did not pass"
        )

    def _heard(self) -> bool:
        received = self._measured.latest()
        if received is not None:
            self._now = received.message.time
        return received is not None


# --- results -----------------------------------------------------------------------------------------------


def _ms(seconds: float) -> float | None:
    return 1e3 * seconds if np.isfinite(seconds) else None


def _table(profile: str, latencies: Latencies) -> Table:
    columns = ["segment", "mean", "5 %", "median", "95 %", "samples", "by correlation", "sd", "samples", "by stamps"]
    notes = _NOTES | _TO_PLANT[latencies.driven]
    return Table(
        f"Segments, {profile} [ms]", columns, [_row(segment, notes[segment.name]) for segment in latencies.segments]
    )


def _first(profile: str, latencies: Latencies) -> Table:
    """Table of the time to a joint's first milliradian, and its parts."""
    first = latencies.first
    messages = latencies["Reference → VEC"].mean + latencies["VEC → Motor"].mean
    begun, moved, seen = (_mean(each) for each in (first.vec, first.motor, first.measured))
    through = latencies["VEC → Motor"].mean
    rows = [
        ("VEC", begun, "what is asked begins at rest"),
        ("Motor", moved, f"{1e3 * messages:.1f} by stamps; the rest is the motion's own beginning, and "
         f"{1e3 * (moved - begun - through):+.1f}: limits of acceleration (+), lead over the joint's servo (−)"),
        ("Prop.", seen, "the joint's own servo"),
    ]  # fmt: skip
    shown = [[name, "–" if np.isnan(value) else f"{1e3 * value:.2f}", str(len(first.vec)), note]
             for name, value, note in rows]  # fmt: skip
    return Table(f"From a reference to a joint's first milliradian, {profile} [ms]",
                 ["in", "mean", "samples", "why"], shown)  # fmt: skip


def _bounds(profile: str, found: Sequence[Conversion]) -> Table:
    """Table of upper bounds of the cost of conversions."""
    rows = [
        [each.segment.name, _TRANSPORTS[each.transport],
         *(f"{1e3 * value:.2f}" for value in (each.segment.mean, each.least, each.mean, each.median)),
         f"{1e3 * float(np.median(each.floor)):.2f}"]
        for each in found
    ]  # fmt: skip
    columns = ["segment", "comes over", "mean", "a double at least", "less it", "median less it", "a double's median"]
    return Table(f"What conversions cost at most, {profile} [ms]", columns, rows)


def _row(segment: Segment, note: str) -> list[str]:
    stamps, lags = segment.by_stamps, segment.by_correlation
    low, high = segment.interval
    shown = [segment.mean, low, segment.median, high]
    behind = [f"{1e3 * value:.2f}" for value in (lags.mean(), lags.std())] if len(lags) else ["–"] * 2
    return [segment.name, *(f"{1e3 * value:.2f}" if len(stamps) else "–" for value in shown), str(len(stamps)),
            *behind, str(len(lags)), note]  # fmt: skip


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
