"""Control modes that may be requested, by the table of the VRC."""

from __future__ import annotations

from dataclasses import dataclass

from valor.common import mode_names
from valor.common.behaviors import MANIPULATING
from valor.common.messages import ModeStatus

FLAGS = ModeStatus


@dataclass(frozen=True)
class Mode:
    """State of the control mode, empty if unknown; ``status`` has flags of ``ControlModeStatus``."""

    current: str = ""
    requested: str = ""
    status: int = 0

    @property
    def under_way(self) -> str:
        """Target mode of a running change, or empty."""
        return self.requested if self.status & FLAGS.MODE_PROCESSING else ""


class Modes:
    """Table of modes, in order."""

    def __init__(self, arms: bool = True) -> None:
        """``arms``: whether the robot can manipulate."""
        self._table = mode_names.modes()
        self._reported = mode_names.reported()
        self.names = list(self._table)
        self._arms = arms

    def why_not(self, name: str, mode: Mode, behavior: str = "") -> str:
        """Return why a mode may not be requested in a behavior; empty if it may."""
        if not mode.current:
            return "the robot's control mode is not known"
        under_way = mode.under_way
        if name == mode.current and not under_way:
            return "the robot is in it"
        if not self._arms and (self._table[name]["motion"] or [""])[-1] in MANIPULATING:
            return "the robot has no arm to manipulate with"
        if under_way and not (self._table[name].get("preempts") and under_way != name):
            return f"the change to {under_way} is under way"
        if name not in self._followers(mode.current, behavior):
            return f"not from {mode.current}: first {self._first_towards(name, mode.current)}"
        return ""

    def _followers(self, current: str, behavior: str) -> set[str]:
        """Return the next modes; a mode without a motion keeps the behavior, and also has its restrictions."""
        follows = set(self._table[current]["to"])
        if not self._table[current]["motion"]:
            kept = self._reported.get(behavior, current)
            follows &= {*self._table[kept]["to"], kept}
        return follows

    def _first_towards(self, name: str, start: str) -> str:
        """Return the first mode of the shortest path to another."""
        ways = {start: ""}
        for here in (frontier := [start]):
            for there in sorted(self._table[here]["to"]):
                if there not in ways:
                    ways[there] = ways[here] or there
                    frontier.append(there)
        return ways.get(name, "another way: none leads there")


def report(mode: Mode) -> str:
    """Describe the latest status; empty if nothing is wrong."""
    status = mode.status
    if status & FLAGS.MODE_PROCESSING:
        return f"changing to {mode.requested} …"
    if status & FLAGS.MODE_REJECTED:
        flags = ", ".join(flag.name for flag in FLAGS if status & flag and flag.name and flag.name.startswith("ERR"))
        return f"{mode.requested} was refused ({flags or 'without a flag'})"
    if status & FLAGS.MODE_PREEMPTED:
        return f"the change to {mode.requested} was preempted"
    if status & FLAGS.EXTERNAL_CHANGE:
        return f"changed to {mode.current} without being asked"
    return ""
