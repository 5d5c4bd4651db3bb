"""`robot new`: makes a robot's folder from its model, with questions on the terminal."""

from __future__ import annotations

import contextlib
import shlex
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from valor.common.errors import ConfigurationError, ValorError
from valor.common.resources import robots
from valor.valorctl.terminal.console import Interruption, Progress, progress, say, say_rows

if TYPE_CHECKING:
    from valor.robot_setup.robot_yaml import RobotDraft
    from valor.robot_setup.source import Prompt, Question

TABLE = "robot.yaml"


def make(model: Path, name: str | None, out: Path | None, *, guess: bool, replace: bool) -> None:
    """Make a robot's folder from MJCF or URDF, print what was found and what to do next.

    ``name``: None: ask; ``out``: folder, None: by name; ``guess``: ask nothing; ``replace``: an earlier robot.
    """
    model = model.expanduser()
    if wanted := out or (name and Path(name)):
        _require_free(wanted.expanduser(), model, replace)
    with progress() as shown:
        from valor.robot_setup.new import draft_robot
        from valor.robot_setup.source import accept_guess

        ask = accept_guess if guess else _asking(shown)
        made = draft_robot(model, name, ask, shown.stage)
        folder = (out or Path(made.name)).expanduser()
        _require_free(folder, model, replace)
        shown.stage(f"writing {folder}")
        with Interruption() as interruption, _draft(folder) as draft:
            made.write(draft)
            interruption.check()
    say_rows(_found(made))
    here = shlex.quote(f"./{folder}" if str(folder) in robots() else str(folder))
    say(f"\n{folder}: model.xml and {TABLE}, which explains every guess. Next:")
    say(f"  valorctl robot check {here}")
    say(f"  valorctl robot get-up {here}")
    say(f"  valorctl up --robot {here}")


def _asking(shown: Progress) -> Prompt:
    def ask(question: Question) -> str:
        shown.clear()
        kind = click.Choice(question.choices) if question.choices else None
        try:
            return str(click.prompt(question.text, default=question.guess, type=kind)).strip()
        except click.Abort:
            say("")
            raise ValorError(f"{question.text}: no answer; expected one, or --yes") from None

    return ask


def _require_free(folder: Path, model: Path, replace: bool) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ConfigurationError(f"{folder}: is a file; expected a new folder")
    if folder.resolve() in model.resolve().parents:
        raise ConfigurationError(f"{folder}: contains the source {model.name}; expected another --out")
    if not any(folder.iterdir()):
        return
    if not replace:
        raise ConfigurationError(f"{folder}: exists; expected another --out, or --force to replace it")
    if not (folder / TABLE).is_file():
        raise ConfigurationError(f"{folder}: --force replaces robots' folders only, and this one has no {TABLE}")


@contextlib.contextmanager
def _draft(folder: Path) -> Iterator[Path]:
    """Make a folder next to its final path, and move it there at the end; the replaced folder is deleted."""
    try:
        folder.absolute().parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.absolute().parent) as room:
            draft = Path(room) / folder.name
            draft.mkdir()
            yield draft
            if folder.exists():
                shutil.move(folder, draft.with_name(f"{folder.name}.before"))
            draft.rename(folder)
    except OSError as error:
        raise ConfigurationError(f"{folder}: {error.strerror or error}") from None


def _found(made: RobotDraft) -> list[tuple[str, str]]:
    robot, stance = made.robot, made.stance
    passive = robot.passive
    soles = (f"{1e2 * (s.toe - s.heel):.1f} × {2e2 * s.half_width:.1f} cm" for s in made.geometry.soles.values())
    welded = [*(j for j, moves in passive.hinges.items() if not moves), *passive.unsupported]

    def names(joints: list[int]) -> str:
        return ", ".join(map(robot.joint_name, joints)) or "none"

    return [
        ("robot", f"{made.name}: {len(made.drives)} joints, {made.mass:.1f} kg"),
        ("base, chest", f"{robot.name(robot.pelvis)}, {robot.name(robot.chest)}"),
        *((f"{side} leg", names(limb.joints)) for side, limb in robot.legs.items()),
        ("knees", ", ".join(stance.knees)),
        *((f"{side} arm", names(limb.joints)) for side, limb in robot.arms.items()),
        ("waist, neck", f"{names(robot.waist)}; {names(robot.neck)}"),
        ("simulated, undriven", names(sorted(passive.simulated))),
        ("welded", names(welded)),
        ("soles", ", ".join(dict.fromkeys(soles))),
        ("leg", f"{stance.leg_length:.3f} m; CoM {stance.com_height:.3f} m high"),
    ]
