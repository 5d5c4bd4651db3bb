"""Latencies as the thesis has all of them (4.3.2): lags of the joints' positions from tap to tap, motion by motion.

And how long a motion takes to its first milliradian, which stamps do not tell: what is asked begins at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valor.analysis.errors import SignalError
from valor.analysis.lag import lag
from valor.analysis.pathway_taps import Motion, Taps
from valor.analysis.signals import Signal
from valor.common.arrays import FloatArray

LONGEST = 0.25  # delay that is looked for [s]
BEFORE, AFTER = 0.15, 0.45  # a motion, that its signals are looked at [s]
MOVED = 0.05  # a joint that goes less far says nothing of delays [rad]
STARTED = 0.001  # [rad]


@dataclass(frozen=True)
class Lags:
    """By cross-correlation, one a motion and joint [s].

    Attributes:
        setpoint: VEC to set-points.
        motor: VEC to Motor.
        plant: what left for the plant to the measured joint.
        state: measured to joint states.
    """

    setpoint: FloatArray
    motor: FloatArray
    plant: FloatArray
    state: FloatArray


@dataclass(frozen=True)
class FirstMilliradian:
    """From a reference sent until a joint has gone so far, one a motion and joint [s]: (m,) each.

    Attributes:
        vec: in the control values.
        motor: in Motor; later than ``vec`` by what the Motion System takes, its limits of acceleration included.
        measured: in Proprioceptor.
    """

    vec: FloatArray
    motor: FloatArray
    measured: FloatArray


@dataclass(frozen=True)
class _Moves:
    """A joint in a motion, at the taps."""

    motion: Motion
    vec: Signal
    setpoint: Signal | None
    motor: Signal | None
    command: Signal | None
    measured: Signal | None
    state: Signal | None


def lags(taps: Taps) -> tuple[Lags, FirstMilliradian]:
    """What the signals tell."""
    found: tuple[list[float], ...] = ([], [], [], [])
    started: list[tuple[float, ...]] = []
    for joint in _moves(taps):
        pairs = (joint.vec, joint.setpoint), (joint.vec, joint.motor), (joint.command, joint.measured), (
            joint.measured, joint.state,
        )  # fmt: skip
        for each, (earlier, later) in zip(found, pairs, strict=True):
            each.extend(_lag(earlier, later))
        started.append(tuple(_started(signal, joint.motion) for signal in (joint.vec, joint.motor, joint.measured)))
    first = np.array(started, dtype=np.float64).reshape(-1, 3)
    vec, motor, measured = first[np.isfinite(first).all(axis=1)].T
    return Lags(*(np.array(each) for each in found)), FirstMilliradian(vec, motor, measured)


def _moves(taps: Taps) -> list[_Moves]:
    names = list(taps.vec.messages[0].joint_names)
    positions = taps.vec["reference.positions"][taps.vec_rows]
    setpoints = taps.setpoints.by_joint("position", taps.setpoints.sent)
    told = taps.joint_states.by_joint("position", taps.joint_states.sent)
    left_at, left, driven = taps.driven()
    found = []
    for motion in taps.motions():
        first, last = motion.asked - BEFORE, motion.end + AFTER
        for joint in sorted(motion.joints & set(names) & setpoints.keys()):
            column = taps.robot.index[joint]
            vec = _part(taps.vec_time, positions[:, names.index(joint)], first, last)
            if vec is None or np.ptp(vec.value) < MOVED:
                continue
            signals = (
                setpoints[joint],
                (taps.motor.sent, taps.commanded[:, column]),
                (left_at, left[:, driven.index(column)]),
                (taps.senses.sent, taps.measured[:, column]),
                told[joint],
            )
            found.append(_Moves(motion, vec, *(_part(time, value, first, last) for time, value in signals)))
    return found


def _part(time: FloatArray, value: FloatArray, first: float, last: float) -> Signal | None:
    """The part of a signal between two moments [s]; None: there is too little of it."""
    try:
        return Signal.of(time, value).between(first, last)
    except SignalError:
        return None


def _lag(earlier: Signal | None, later: Signal | None) -> list[float]:
    """How much later the second one is [s], alone; nothing where it cannot be told."""
    if earlier is None or later is None:
        return []
    try:
        return [lag(earlier, later, LONGEST).seconds]
    except SignalError:
        return []


def _started(signal: Signal | None, motion: Motion) -> float:
    """When a signal has gone a milliradian, since the motion was asked for [s]; NaN: never, or it moved before."""
    if signal is None:
        return float("nan")
    before = signal.value[signal.time <= motion.asked]
    away = np.abs(signal.value - (before[-1] if before.size else np.nan)) > STARTED
    gone = np.flatnonzero(away & (signal.time > motion.asked))
    moved_before = before.size and np.ptp(before) > STARTED
    return float(signal.time[gone[0]] - motion.asked) if gone.size and not moved_before else float("nan")
