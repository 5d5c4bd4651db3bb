"""A robot's folder out of its model: questions on a terminal, what was found as a table, and all of it or nothing."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from valor.common.errors import ConfigurationError, ValorError
from valor.common.resources import robots
from valor.valorctl import whole_folder
from valor.valorctl.console import Progress, progress, say, say_rows
from valor.valorctl.interruption import Interruption

if TYPE_CHECKING:
    from valor.robot_setup.new import Study
    from valor.robot_setup.questions import Ask, Question

TABLE = "robot.yaml"


def make(model: Path, name: str | None, out: Path | None, *, guess: bool, replace: bool) -> None:
    """Make a robot's folder, and say what was found and what comes next.

    Args:
        model: MJCF or URDF.
        name: of the robot; None: asked for.
        out: the folder; None: one of the robot's name, here.
        guess: whether to ask nothing.
        replace: whether a robot's folder that is there makes way.

    Raises:
        ValorError: the model is not fit, the folder is in the way, or nobody answers.
    """
    model = model.expanduser()
    if wanted := out or (name and Path(name)):
        _require_free(wanted.expanduser(), model, replace)
    with progress() as shown:
        from valor.robot_setup import new, questions

        ask = questions.guess if guess else _asking(shown)
        made = new.study(model, name, ask, shown.stage)
        folder = (out or Path(made.content.name)).expanduser()
        _require_free(folder, model, replace)
        shown.stage(f"writing {folder}")
        with Interruption() as interruption, whole_folder.beside(folder) as draft:
            made.write(draft)
            interruption.check()
            whole_folder.put(draft, folder)
    say_rows(_found(made))
    here = shlex.quote(f"./{folder}" if str(folder) in robots() else str(folder))  # not ours of that name
    say(f"\n{folder}: model.xml and {TABLE}, in which every guess says why. Next:")
    say(f"  valorctl robot check {here}")
    say(f"  valorctl up --robot {here}")


def _asking(shown: Progress) -> Ask:
    """Questions go to whoever sits there."""

    def ask(question: Question) -> str:
        import click

        shown.clear()
        kind = click.Choice(question.choices) if question.choices else None
        try:
            return str(click.prompt(question.text, default=question.guess, type=kind)).strip()
        except click.Abort:
            say("")
            raise ValorError(f"{question.text}: nobody answers; expected an answer, or --yes") from None

    return ask


def _require_free(folder: Path, model: Path, replace: bool) -> None:
    whole_folder.require_free(folder, TABLE, "robots' folders", replace)
    if folder.exists() and folder.resolve() in model.resolve().parents:
        raise ConfigurationError(f"{folder}: holds {model.name}, which it is made of; expected another --out")


def _found(made: Study) -> list[tuple[str, str]]:
    """What, and how much."""
    content, robot = made.content, made.content.robot
    stance, model = content.stance, robot.source.mj
    root = robot.name(next(b for b in sorted(robot.edges) if int(model.body_parentid[b]) not in robot.edges))
    pelvis = robot.name(robot.pelvis)
    sides = {side: limb.joints for side, limb in robot.legs.items()}
    fingers = [j for limb in robot.arms.values() for j in limb.beyond]
    soles = (f"{1e2 * (s.toe - s.heel):.1f} × {2e2 * s.half_width:.1f} cm" for s in content.soles.values())
    bend = abs(stance.angles.get(stance.knees[0], 0.0))
    guesses = sum(len(drive.guesses) for drive in content.drives.values())

    def names(joints: list[int]) -> str:
        return ", ".join(map(robot.joint_name, joints)) or "none"

    return [
        ("robot", f"{content.name}: {len(content.drives)} joints, {content.mass:.1f} kg"),
        ("base", pelvis + ("" if root == pelvis else f"; the model's root is {root}")),
        ("chest", robot.name(robot.chest)),
        *((f"{side} leg", names(joints)) for side, joints in sides.items()),
        ("knees", ", ".join(stance.knees)),
        ("waist", names(robot.waist)),
        *((f"{side} arm", names(limb.joints)) for side, limb in robot.arms.items()),
        *([] if robot.arms else [("arms", "none")]),
        ("neck", names(robot.neck)),
        ("hands", f"{len(fingers)} joints" if fingers else "no joints"),
        *((group, names(joints)) for group, joints in robot.others.items()),
        ("simulated, undriven", names(sorted(robot.passive.simulated))),
        ("welded", names([*(j for j, moves in robot.passive.hinges.items() if not moves), *robot.passive.gone])),
        ("soles", ", ".join(dict.fromkeys(soles))),
        (
            "leg",
            f"{stance.leg_length:.3f} m; hips {stance.hip_height:.3f} m over the ankles, knees bent {bend:.2f} rad",
        ),
        ("CoM", f"{stance.com_height:.3f} m high; base {stance.base_height:.3f} m"),
        ("presets", ", ".join(content.arm_presets) or "none"),
        ("guessed", f"{guesses} of the joints' numbers, and what the comments say"),
    ]
