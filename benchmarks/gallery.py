"""The films of docs/gallery.md and that page: each scene in a system of its own, played, filmed, and written down.

``make gallery`` or ``python -m benchmarks.gallery [SCENE …]``. Some two minutes a scene on two idle cores.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from harness.strangers import ROBOTS, folder_of
from valor.analysis.film import moments
from valor.analysis.film.moments import STATE
from valor.common.instance import Instance
from valor.common.topics import MOTION_STATE
from valor.valorctl.drive.node import join, next_message

_ROOT = Path(__file__).resolve().parents[1]
_PAGE = _ROOT / "docs" / "gallery.md"
_FILMS = Path("docs") / "pictures"
_BAGS = Path("output") / "gallery"
_G1 = _BAGS / "g1"
_VALORCTL = Path(sys.executable).with_name("valorctl")
_LARGEST, _ALL = 3_000_000, 12_000_000  # of a film, and of all [B]
_BESIDE = 0.6  # of what is filmed, before and after [s]
_SILENT = 30.0  # robot, at most [s]
_LOOK = 0.05  # at what the robot did [s]
_TRIES, _REST = 20, 2.0  # to get up, and between them [s]
_INSTANCE = os.environ.get("VALOR_INSTANCE", "gallery")
_ENVIRONMENT = os.environ | {"VALOR_INSTANCE": _INSTANCE}
_ALWAYS = (-math.inf, math.inf)

_HEAD = """# Gallery

Films of recordings, in real time unless stated; `make gallery` runs their commands.
"""


class Script:
    """A scene's commands while they are run; those that the page shows are kept."""

    def __init__(self, name: str) -> None:
        self.up = SCENES[name].up is not None
        self.film, self.bag, self.shown = _FILMS / f"{name}.webp", _BAGS / f"{name}.mcap", list[str]()

    def __call__(self, *words: object) -> str:
        """A command that has to succeed; returns what it says."""
        self.shown.append(self._text(words))
        return self._run(words, check=True).stdout

    def until(self, *words: object) -> None:
        """A command that may be refused at first."""
        self.shown.append(self._text(words))
        for _ in range(_TRIES):
            if not self._run(words, check=False).returncode:
                return
            time.sleep(_REST)
        raise SystemExit(f"{self._text(words)}: refused {_TRIES} times")

    def beside(self, *words: object) -> subprocess.Popen[bytes]:
        """A command that goes on while others follow."""
        self.shown.append(f"{self._text(words)} &")
        return subprocess.Popen([_VALORCTL, *map(str, words)], cwd=_ROOT, env=_ENVIRONMENT)

    def passed(self, seconds: float) -> float:
        """Wait for so much robot time; returns what it is then [s]."""
        with join(Instance.from_environment(_INSTANCE)) as node:
            states = MOTION_STATE.subscriber(node)
            until = now = next_message(MOTION_STATE, states, _SILENT).time
            until += round(1e9 * seconds)
            while now < until:
                now = next_message(MOTION_STATE, states, _SILENT).time
        return 1e-9 * now

    def video(self, behaviors: Collection[str], *words: object, within: tuple[float, float] = _ALWAYS) -> None:
        """Film the bag while the robot was in some behaviors, within a robot time [s]; the system is down meanwhile."""
        if self.up:
            self("down")
        found = moments.read(_ROOT / self.bag, 0.0, None, _LOOK, lambda seconds: None)
        inside = [
            time - found.first
            for time, moment in zip(found.times, found.known, strict=True)
            if STATE in moment and moment[STATE].behavior in behaviors and within[0] <= time <= within[1]
        ]
        span = ("--from", round(max(0.0, inside[0] - _BESIDE), 1), "--to", round(inside[-1] + _BESIDE, 1))
        self("video", self.bag, *span, *words, "--overlay", "modes", "--out", self.film)

    @staticmethod
    def _text(words: tuple[object, ...]) -> str:
        return " ".join(["valorctl", *map(str, words)])

    def _run(self, words: tuple[object, ...], *, check: bool) -> subprocess.CompletedProcess[str]:
        print("$", self._text(words), flush=True)
        done = subprocess.run(
            [_VALORCTL, *map(str, words)], cwd=_ROOT, env=_ENVIRONMENT, text=True, stdout=subprocess.PIPE, check=check
        )
        print(done.stdout, end="", flush=True)
        return done


def _walk(script: Script) -> None:
    script("walk", "--vx", 0.4, "--for", 8)
    script.video({"walk"})


def _stairs(script: Script) -> None:
    script("step", "stairs")
    script.video({"step"}, "--camera", "left", "--speed", 2)


def _rubble(script: Script) -> None:
    script("walk", "--vx", 0.25, "--distance", 2.0)
    script.video({"walk"}, "--speed", 2)


def _push(script: Script) -> None:
    told = re.search(r"at ([\d.]+) s", script("push", 40, 0, 0))
    assert told is not None
    at = float(told[1])
    script.passed(3.5)
    script.video({"stand"}, "--speed", 0.5, within=(at - 0.2, at + 2.8))


def _get_up(script: Script) -> None:
    script("push", 110, 0, 0)
    script.until("get-up")
    script.video({"fall", "get_up"}, "--camera", "fixed", "--speed", 2)


def _get_up_from_the_back(script: Script) -> None:
    script("robot", "get-up", _G1)
    script("up", "--robot", _G1, "--rtf", 0, "--bag", script.bag)
    script("push", -60, 0, 0)
    script.until("get-up")
    script("down")
    script.video({"fall", "get_up"}, "--camera", "fixed")


def _arms(script: Script) -> None:
    script("mode", "walk_manipulate")
    walking = script.beside("walk", "--vx", 0.25, "--for", 9)
    script("arm", "right", "forward")
    script("arm", "left", "side")
    if walking.wait():
        raise SystemExit("the robot did not walk")
    script.video({"walk_manipulate"}, "--speed", 1.5)


def _door(script: Script) -> None:
    script("demo", "door", "--seed", 1, "--rtf", 0, "--out", script.bag.parent)
    script.video({"stand_manipulate"}, "--camera", "shoulder", "--speed", 3)


def _made_g1() -> None:
    shutil.rmtree(_ROOT / _G1, ignore_errors=True)
    folder_of("g1", ROBOTS["g1"].model(), _ROOT / _G1, ["ppo"])


def _exchange(script: Script) -> None:
    walking = script.beside("walk", "--vx", 0.3, "--for", 14)
    script.passed(5.0)
    script("controller", "ppo")
    script.passed(4.0)
    script("controller", "whole_body")
    if walking.wait():
        raise SystemExit("the robot did not walk")
    script.video({"walk"})


@dataclass(frozen=True)
class Scene:
    """What is seen, where, of whom, and how it is played.

    Attributes:
        up: options of ``up``; None: what is played has a system of its own.
    """

    title: str
    text: str
    up: tuple[str, ...] | None
    play: Callable[[Script], None]
    before: Callable[[], object] = lambda: None  # makes what ``up`` needs


# fmt: off
SCENES = {
    "walk": Scene("Walking on dirt", "ESCHER at 0.4 m/s over bumps of 2 cm.", ("--world", "dirt"), _walk),
    "climb": Scene("Stairs", "Three steps of 10 cm, by a plan. Twice its speed.", ("--world", "stairs"), _stairs),
    "rubble": Scene("Rubble", "Boxes up to 4 cm high, unknown to it. Twice its speed.", ("--world", "rubble"), _rubble),
    "push": Scene("Push and step", "40 N·s at the chest: it steps to keep its balance. Half speed.", (), _push),
    "fall_and_get_up": Scene("Fall and get up", "110 N·s are too many. Twice its speed.", (), _get_up),
    "get_up_from_the_back": Scene(
        "Get up from the back",
        "A G1 made by `robot new`, on whose model `robot get-up` found how, in some minutes.",
        None, _get_up_from_the_back, _made_g1,
    ),
    "thor_walk": Scene("THOR", "The elder brother, on the dirt.", ("--robot", "thor", "--world", "dirt"), _walk),
    "door": Scene("A door", "Its right fist presses the lever, and pushes. Three times its speed.", None, _door),
    "exchange": Scene(
        "A policy takes over",
        "A G1 made by `robot new` walks: Whole-Body Controller, holosoma's policy `ppo`, Whole-Body Controller.",
        ("--robot", str(_G1)), _exchange, _made_g1,
    ),
    "arms_while_walking": Scene("Arms while walking", "Arms go to presets on the way. 1.5 times its speed.", (), _arms),
}
# fmt: on


def film(name: str) -> list[str]:
    """Play and film a scene; returns the commands."""
    scene, script = SCENES[name], Script(name)
    (_ROOT / script.bag).unlink(missing_ok=True)
    (_ROOT / script.bag).parent.mkdir(parents=True, exist_ok=True)
    scene.before()
    try:
        if scene.up is not None:
            script("up", *scene.up, "--rtf", 0, "--bag", script.bag)
        scene.play(script)
    finally:
        subprocess.run([_VALORCTL, "down"], cwd=_ROOT, env=_ENVIRONMENT, check=False, stdout=subprocess.DEVNULL)
    return script.shown


def _section(name: str, commands: list[str]) -> str:
    scene, lines = SCENES[name], "\n".join(commands)
    picture = Script(name).film.relative_to("docs")
    return f"## {scene.title}\n\n{scene.text}\n\n![{scene.title}]({picture})\n\n```bash\n{lines}\n```\n"


def main() -> None:
    """Make the films asked for, all unless some are named, and their sections of the page."""
    chosen = sys.argv[1:] or list(SCENES)
    for name in chosen:
        made = _section(name, film(name))
        page = _PAGE.read_text() if _PAGE.exists() else ""  # which others may write, too
        kept = {title: section for section in re.split(r"(?m)^(?=## )", page) for title in section.splitlines()[:1]}
        kept[f"## {SCENES[name].title}"] = made
        sections = [kept[title].rstrip() for scene in SCENES.values() if (title := f"## {scene.title}") in kept]
        _PAGE.write_text("\n\n".join([_HEAD.rstrip(), *sections]) + "\n")
    sizes = {name: (_ROOT / Script(name).film) for name in SCENES}
    found = {name: file.stat().st_size for name, file in sizes.items() if file.exists()}
    print({name: f"{size / 1e6:.1f} MB" for name, size in found.items()}, f"{sum(found.values()) / 1e6:.1f} MB in all")
    if max(found.values()) > _LARGEST or sum(found.values()) > _ALL:
        raise SystemExit(f"too large: expected at most {_LARGEST / 1e6:g} MB each, {_ALL / 1e6:g} MB in all")


if __name__ == "__main__":
    main()
