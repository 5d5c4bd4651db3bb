"""Rates of a recorded system: those asked for, and those at which messages came."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from thesis.analysis.pathway_taps import JOINT_STATES
from valor.analysis.reading.recording import recorded
from valor.bags.stored import StoredBag
from valor.common.topics import MOTOR, PROPRIOCEPTOR

TICK = "control tick"  # asked for by robot or profile
RATED = {recorded(PROPRIOCEPTOR): TICK, recorded(MOTOR): "motor commands", JOINT_STATES: "joint states"}


def achieved(bag: Path) -> dict[str, float]:
    """Rates by name, from a topic's first message sent to its last, on the wall clock [Hz]; none of absent topics."""
    sent: dict[str, list[int]] = {}
    for message in StoredBag(bag).messages():
        if name := RATED.get(message.topic.name):
            sent.setdefault(name, []).append(message.sent)
    return {name: 1e9 * (len(at) - 1) / (max(at) - min(at)) for name, at in sent.items() if len(at) > 1}


def told(found: Sequence[Mapping[str, float]]) -> dict[str, str]:
    """Lowest and highest rate by name, of some bags, as text."""
    shown = {}
    for name in RATED.values():
        if rates := sorted(f"{each[name]:.0f}" for each in found if name in each):
            shown[f"{name} came at"] = f"{'–'.join(dict.fromkeys((min(rates, key=int), max(rates, key=int))))} Hz"
    return shown
