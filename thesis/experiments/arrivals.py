"""Tables and measures of the arbitrary goals of the hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from thesis.analysis import hand_goals
from thesis.analysis.hand_goals import Arrival
from thesis.experiments.arbitrary_goals import OUT_OF_REACH, WHERE
from thesis.experiments.experiment import Run
from thesis.report.results import Measure, Table

KEPT, OURS, REAL = "as in the thesis", "this system's own way", "as in the thesis, real arms"


def tell(run: Run, found: Mapping[str, Sequence[Arrival]], refused: Mapping[str, Sequence[str]]) -> None:
    """Add them to a result.

    Args:
        run: the experiment.
        found: arrivals, by method.
        refused: names of rejected goals, by method.
    """
    count = max(len(there) + len(refused[way]) for way, there in found.items())
    run.text += (
        f" Then the arm goes to {count} arbitrary goals, {WHERE[0]} of the pelvis and {WHERE[1]} it in turn, drawn "
        "from the seed within the joints' limits so that no parts of the robot touch on the way. In the thesis' way "
        "each is a posture that a trajectory goes to; in this system's own it is the pose in odom that the hand would "
        "have there on a base that stays, and a hand goal leads to it."
    )
    run.tables.append(
        Table("Arbitrary goals at rest: median, largest",
              ["way, goals", "count", "arm alone [cm]", "by the base [cm]", "from the goal [cm]", "turned [°]",
               "out of reach"],
              [row for way, there in found.items() for row in _rows(way, there)])
    )  # fmt: skip
    run.measures += [measure for way, there in found.items() for measure in _measures(way, there)]
    run.measures.append(_out_of_reach(found, refused))
    run.files.append(hand_goals.write_csv(found, run.out / "arbitrary_goals.csv"))
    run.picture([hand_goals.plot(found, run.out / "arbitrary_goals.png")],
                "How many of the arbitrary goals the hand came how near to, at rest.")  # fmt: skip


def _rows(way: str, there: Sequence[Arrival]) -> list[list[str]]:
    """One a side; the arm alone says nothing where it makes up for the base."""
    rows = []
    for where in WHERE:
        some = [one for one in there if one.name.endswith(where)]
        led = any(one.state for one in some)
        arm = "–" if led else _pair([100.0 * one.arm for one in some])
        rows.append([
            f"{way}, {where}", str(len(some)), arm, _pair([100.0 * one.base for one in some]),
            _pair([100.0 * one.distance for one in some]), _pair([float(np.rad2deg(one.angle)) for one in some]),
            str(sum(one.state == OUT_OF_REACH for one in some)) if led else "–",
        ])  # fmt: skip
    return rows


def _pair(values: Sequence[float]) -> str:
    return f"{np.median(values):.1f}, {max(values):.1f}" if values else "–"


def _measures(way: str, there: Sequence[Arrival]) -> list[Measure]:
    """Median and largest distance from the goal."""
    distance = 100.0 * np.array([one.distance for one in there])
    thesis = {KEPT: "3–6, of presets", REAL: "10, of presets"}.get(way, "")
    return [
        Measure(f"arbitrary goals, {way}: from the goal at rest, {name}", float(of(distance)) if there else None, "cm",
                thesis, "" if there else "none was gone to")
        for name, of in (("median", np.median), ("largest", np.max))
    ]  # fmt: skip


def _out_of_reach(found: Mapping[str, Sequence[Arrival]], refused: Mapping[str, Sequence[str]]) -> Measure:
    """How many were, and why."""
    reasons = [f"{one.name}: {one.reason}" for there in found.values() for one in there if one.state == OUT_OF_REACH]
    reasons += [f"{name}: refused ({way})" for way, names in refused.items() for name in names]
    return Measure("arbitrary goals out of reach", float(len(reasons)), "", "", "; ".join(reasons) or "none")
