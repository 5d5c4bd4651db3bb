"""Latencies as differences of stamps: each message names the one that it was made of, so none is negative.

::

    Proprioceptor.time ◄─ controller_state's header, JointSetpoints.time, JointState's header
    JointSetpoints     ◄─ MotionState.setpoint_sequence ─► proprioceptor_sequence ◄─ Motor
    Motor.sequence     ◄─ HdtCommand.motor_sequence
    HdtCommand         ◄─ HdtState.command_sequence; its positions are found again in the Proprioceptor
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from thesis.analysis.pathway_taps import Indices, Taps, named
from valor.analysis.reading.bag import Series
from valor.common.arrays import FloatArray

RESPONDS = 1e-6  # a control value that is faster moves [rad/s]
_SAME = 1e-9  # positions that are one measurement, whoever tells them [rad]
_LATEST = 20  # Proprioceptors after a state of the driver, within which it is handed on


class Delays(NamedTuple):
    """Latencies (m,) [s], and when each began on the wall clock (m,) [s]."""

    seconds: FloatArray
    at: FloatArray


def since_sensed(taps: Taps, series: Series, robot_time: FloatArray) -> Delays:
    """From a Proprioceptor sent to the message that was made of it sent.

    Args:
        taps: of the bag.
        series: of such messages.
        robot_time: that each of them names [ns].
    """
    rows, sensed = taps.when_sensed(robot_time)
    return Delays(series.sent[rows] - sensed, sensed)


def response(taps: Taps) -> Delays:
    """From a reference sent to the Proprioceptor sent that the first control values that move answer."""
    speed = np.abs(taps.vec["reference.velocities"][taps.vec_rows]).max(axis=1)
    found, at = [], []
    for motion in taps.motions():
        during = (taps.vec_time > motion.asked) & (taps.vec_time < motion.end)
        moving = np.flatnonzero(during & (speed > RESPONDS))
        before = np.flatnonzero(taps.vec_time <= motion.asked)
        if moving.size and before.size and speed[before[-1]] <= RESPONDS:
            found.append(taps.vec_time[moving[0]] - motion.asked)
            at.append(motion.asked)
    return Delays(np.array(found), np.array(at))


def through_motion_system(taps: Taps) -> Delays:
    """From the Proprioceptor that set-points were made for to the first Motor that follows them.

    Set-points that newer ones overtook before a Motor was made are in none.
    """
    rows, sensed = taps.when_sensed(taps.setpoints["time"])
    found, state = named(taps.setpoints["bifrost_sequence"][rows], taps.states["setpoint_sequence"])
    answered, motor = named(taps.states["proprioceptor_sequence"][state], taps.motor["proprioceptor_sequence"])
    began = sensed[found][answered]
    return Delays(taps.motor.sent[motor] - began, began)


def to_plant(taps: Taps) -> tuple[Delays, Delays]:
    """From Motor to what leaves for the plant, and from there to the Proprioceptor that first has its effect."""
    if taps.hdt_commands is None or taps.hdt_states is None:
        return _obeyed(taps)
    return _through_driver(taps, taps.hdt_commands, taps.hdt_states)


def _obeyed(taps: Taps) -> tuple[Delays, Delays]:
    """Without a driver: a Motor is in force from the Proprioceptor on before the first that names it."""
    rows, place = named(taps.motor["sequence"], taps.senses["motor_sequence"])
    sent = taps.motor.sent[rows]
    in_force = np.maximum(sent, taps.senses.sent[np.maximum(place - 1, 0)])
    return Delays(in_force - sent, sent), Delays(taps.senses.sent[place] - in_force, in_force)


def _through_driver(taps: Taps, commands: Series, states: Series) -> tuple[Delays, Delays]:
    carried = commands["motor_sequence"]
    first = np.flatnonzero((carried > 0.0) & (np.diff(carried, prepend=-1.0) != 0.0))
    rows, motor = named(carried[first], taps.motor["sequence"])
    sent = taps.motor.sent[motor]
    to_command = Delays(commands.sent[first[rows]] - sent, sent)

    rows, state = named(commands["sequence"], states["command_sequence"])
    place = _first_with(taps, states, state)
    known = place >= 0
    sent = commands.sent[rows][known]
    return to_command, Delays(taps.senses.sent[place[known]] - sent, sent)


def _first_with(taps: Taps, states: Series, rows: Indices) -> Indices:
    """The first Proprioceptor after each of some states of the driver that has its positions; −1: none has."""
    joints, offset = taps.arm
    told = states["position"][rows] - offset
    after = np.searchsorted(taps.senses.sent, states.sent[rows], side="right")
    found = np.full(len(rows), -1, dtype=np.intp)
    for ahead in range(_LATEST):
        place = after + ahead
        there = place < len(taps.senses)
        place = place.clip(max=len(taps.senses) - 1)
        has = np.abs(taps.measured[place][:, joints] - told).max(axis=1) < _SAME
        found = np.where((found < 0) & there & has, place, found)
    return found


def mode_changes(taps: Taps) -> tuple[Delays, Delays]:
    """From a command sent to the behavior changed, and from that to the report sent."""
    commands, reports = taps.mode_commands, taps.mode_reports
    behavior, at = taps.states.strings("behavior"), taps.states.sent
    changed_at = at[1:][behavior[1:] != behavior[:-1]]
    told_mode = reports.strings("current_control_mode")
    to_change, to_report, asked, seen = [], [], [], []
    following = np.append(commands.sent[1:], np.inf)
    for sent, until, message in zip(commands.sent, following, commands.messages, strict=True):
        changes = changed_at[(changed_at > sent) & (changed_at < until)]
        if not changes.size:
            continue
        told = (reports.sent > changes[0]) & (told_mode == message.requested_control_mode)
        if told.any():
            to_change.append(changes[0] - sent)
            to_report.append(reports.sent[told][0] - changes[0])
            asked.append(sent)
            seen.append(changes[0])
    return Delays(np.array(to_change), np.array(asked)), Delays(np.array(to_report), np.array(seen))
