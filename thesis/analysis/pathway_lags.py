"""Latencies by the thesis' method (4.3.2): lags of joint positions between taps, per motion.

Also the time from a reference to a joint's first milliradian, which includes the start of the motion from rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thesis.analysis.lag import lag
from thesis.analysis.pathway_taps import Motion, Taps
from thesis.analysis.signals import Signal
from thesis.errors import SignalError
from valor.common.arrays import FloatArray

LONGEST = 0.25  # maximum delay [s]
BEFORE, AFTER = 0.15, 0.45  # margins of the signals around a motion [s]
MOVED = 0.05  # minimum motion of a joint [rad]
STARTED = 0.001  # [rad]


@dataclass(frozen=True)
class Lags:
    """Lags by cross-correlation, one per motion and joint [s].

    Attributes:
        setpoint: VEC to set-points.
        motor: VEC to Motor.
        plant: command to the plant to the measured joint.
        state: measured to joint states.
    """

    setpoint: FloatArray
    motor: FloatArray
    plant: FloatArray
    state: FloatArray


@dataclass(frozen=True)
class FirstMilliradian:
    """Time from a reference to a joint's first milliradian, one per motion and joint [s]: (m,) each.

    Attributes:
        vec: in the control values.
        motor: in Motor; later than ``vec`` by the latency of the Motion System, its limits of acceleration included.
        measured: in Proprioceptor.
    """

    vec: FloatArray
    motor: FloatArray
    measured: FloatArray


@dataclass(frozen=True)
class _Moves:
    """Signals of a joint in a motion, at the taps."""

    motion: Motion
    vec: Signal
    setpoint: Signal | None
    motor: Signal | None
    command: Signal | None
    measured: Signal | None
    state: Signal | None


def lags(taps: Taps) -> tuple[Lags, FirstMilliradian]:
    """Compute lags and times to the first milliradian."""
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
    """Part of a signal between two times [s]; None if it is too short."""
    try:
        return Signal.of(time, value).between(first, last)
    except SignalError:
        return None


def _lag(earlier: Signal | None, later: Signal | None) -> list[float]:
    """Lag of the second signal [s], as a list of one; empty if it cannot be determined."""
    if earlier is None or later is None:
        return []
    try:
        return [lag(earlier, later, LONGEST).seconds]
    except SignalError:
        return []


def _started(signal: Signal | None, motion: Motion) -> float:
    """Time from the request of a motion to a signal's first milliradian [s]; NaN if there is none, or one before."""
    if signal is None:
        return float("nan")
    before = signal.value[signal.time <= motion.asked]
    away = np.abs(signal.value - (before[-1] if before.size else np.nan)) > STARTED
    gone = np.flatnonzero(away & (signal.time > motion.asked))
    moved_before = before.size and np.ptp(before) > STARTED
    return float(signal.time[gone[0]] - motion.asked) if gone.size and not moved_before else float("nan")
