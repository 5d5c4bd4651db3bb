"""Signals of a joint: goal, VRC set-point, motor command, encoder (thesis 5.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes

from thesis.analysis.figures import key, keys
from thesis.analysis.lag import Lag, lag
from thesis.analysis.signals import Signal
from thesis.analysis.timeline import Timeline
from thesis.errors import SignalError
from valor.analysis import style
from valor.analysis.bands import bands_of
from valor.analysis.reading.recording import Recording
from valor.bags.errors import BagError
from valor.common.arrays import FloatArray
from valor.common.topics import JOINT_SETPOINTS, MOTION_STATE, MOTOR, PROPRIOCEPTOR

Quantity = Literal["position", "velocity"]


@dataclass(frozen=True)
class JointSignals:
    """Signals of one joint over robot time [s].

    Attributes:
        joint: its name.
        reference: (time, goal) steps [rad]; NaN before the first.
        setpoint: position [rad] and velocity [rad/s] from the VRC.
        command: of the Motion Manager to the motor.
        measured: by the encoder.
    """

    joint: str
    reference: tuple[FloatArray, FloatArray]
    setpoint: dict[Quantity, Signal]
    command: dict[Quantity, Signal]
    measured: dict[Quantity, Signal]

    @classmethod
    def of(cls, recording: Recording, timeline: Timeline, joint: str) -> JointSignals:
        """From a bag, over the motions of the experiment.

        Raises:
            BagError: the bag lacks a topic, or no motion moved that joint.
        """
        motions = [motion for motion in timeline.motions if joint in motion.goal]
        if not motions:
            raise BagError(f"{recording.bag.path}: no motion moved {joint}")
        recording.load(PROPRIOCEPTOR, MOTOR, MOTION_STATE, JOINT_SETPOINTS)
        first, last = motions[0].start, motions[-1].end
        column = recording.robot.index[joint]
        senses, motor = recording.series(PROPRIOCEPTOR), recording.series(MOTOR)
        asked = {
            quantity: recording.series(JOINT_SETPOINTS).by_joint(quantity)[joint]
            for quantity in ("position", "velocity")
        }
        return cls(
            joint,
            (senses.time, timeline.reference(joint, senses.time)),
            {q: Signal.of(*asked[q]).between(first, last) for q in ("position", "velocity")},
            {
                q: Signal.of(motor.time, recording.joints(MOTOR, q)[:, column]).between(first, last)
                for q in ("position", "velocity")
            },
            {
                q: Signal.of(senses.time, recording.joints(PROPRIOCEPTOR, f"joint_{q}")[:, column]).between(first, last)
                for q in ("position", "velocity")
            },
        )

    @property
    def response(self) -> Lag | None:
        """Lag of the encoder behind the motor command; None if it cannot be determined."""
        try:
            return lag(self.command["position"], self.measured["position"], longest=0.5)
        except SignalError:
            return None

    def largest_error(self, of: Quantity = "position") -> float:
        """Largest deviation of the measurement from the set-point [rad, rad/s]."""
        wanted = self.measured[of].resampled(self.setpoint[of].time)
        return float(np.abs(wanted - self.setpoint[of].value).max())

    def final_error(self, timeline: Timeline) -> float:
        """Largest error at rest after the motions of this joint, measurement minus goal [rad]."""
        errors = []
        for motion in timeline.motions:
            if self.joint in motion.goal:
                rest = self.measured["position"].between(*motion.rest)
                errors.append(float(rest.value.mean()) - motion.goal[self.joint])
        return max(errors, key=abs)


def draw(recording: Recording, signals: Sequence[JointSignals], quantity: Quantity, title: str, file: Path) -> Path:
    """Plot one panel per joint."""
    columns = 2
    rows = -(-len(signals) // columns)
    unit = {"position": "rad", "velocity": "rad/s"}[quantity]
    height = 1.45 + 1.75 * rows
    figure = style.figure(11.0, height)
    grid = figure.add_gridspec(
        rows, columns, left=0.075, right=0.985, bottom=0.5 / height, top=1.0 - 1.4 / height, hspace=0.5, wspace=0.16
    )
    for i, one in enumerate(signals):
        axes = figure.add_subplot(grid[i // columns, i % columns])
        _panel(axes, recording, one, quantity)
        style.quiet(axes, one.joint, "robot time [s]" if i >= len(signals) - columns else "",
                    f"{quantity} [{unit}]" if i % columns == 0 else "")  # fmt: skip
    style.heading(figure, title, "goals of clients, VRC's set-points, the Motion System's commands, encoders")
    key(figure, _named(recording, signals[0], quantity))
    return style.save(figure, file)


def neck(recording: Recording, signals: JointSignals, file: Path) -> Path:
    """Plot position and velocity of one joint (figure 5.4)."""
    figure = style.figure(11.0, 4.1)
    grid = figure.add_gridspec(1, 2, left=0.07, right=0.985, bottom=0.13, top=0.68, wspace=0.17)
    quantities: tuple[Quantity, ...] = ("position", "velocity")
    for i, quantity in enumerate(quantities):
        axes = figure.add_subplot(grid[i])
        _panel(axes, recording, signals, quantity)
        style.quiet(axes, quantity, "robot time [s]", "[rad]" if i == 0 else "[rad/s]")
    style.heading(figure, f"{signals.joint}: control signals", "goals give positions only, so no goal has a velocity")
    key(figure, _named(recording, signals, "position"))
    return style.save(figure, file)


def _named(recording: Recording, signals: JointSignals, quantity: Quantity) -> list[Artist]:
    """Legend of signals and behaviors; goals have no velocity."""
    names = {"goal": style.REFERENCE, "VRC": style.SETPOINT, "motor command": style.COMMAND, "measured": style.MEASURED}
    lines: list[Artist] = [style.sample(name, color, 1.8) for name, color in names.items()]
    return lines[quantity == "velocity" :] + keys(recording.behaviors(signals.measured[quantity].time))


def _panel(axes: Axes, recording: Recording, one: JointSignals, quantity: Quantity) -> None:
    start, end = float(one.measured[quantity].time[0]), float(one.measured[quantity].time[-1])
    if quantity == "position":
        at, goal = one.reference
        near = (at >= start) & (at <= end)
        style.curve(axes, at[near] - start, goal[near], style.REFERENCE, 1.2)
    for signal, color, width in (
        (one.measured[quantity], style.MEASURED, 2.2),
        (one.command[quantity], style.COMMAND, 1.4),
        (one.setpoint[quantity], style.SETPOINT, 0.9),
    ):
        style.curve(axes, signal.time - start, signal.value, color, width)
    low, high = axes.get_ylim()
    room = max(high - low, 0.1)
    middle = 0.5 * (low + high)
    axes.set_ylim(middle - 0.62 * room, middle + 0.52 * room)  # below: the bands
    axes.set_xlim(0.0, end - start)
    bands_of(axes, recording, start, end, label=False)
