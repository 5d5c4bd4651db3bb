"""``step``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valor.common.errors import ValorError
from valor.common.resources import plan_file, plans
from valor.valorctl import completion
from valor.valorctl.console import say, say_json
from valor.valorctl.interruption import Interruption
from valor.valorctl.verbs.options import Json, Video


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(context_settings={"ignore_unknown_options": True})(step)


def step(
    plan: Annotated[
        str | None,
        typer.Argument(help=f"A plan's file, or one of {', '.join(plans())}.", autocompletion=completion.plans),
    ] = None,
    *,
    to: Annotated[
        tuple[float, float, float] | None,
        typer.Option("--to", metavar="X Y YAW", help="Where the middle of the feet shall go, in odom [m, m, rad]."),
    ] = None,
    relative: Annotated[bool, typer.Option("--relative", help="--to as seen from where the robot stands.")] = False,
    plot: Annotated[Path | None, typer.Option("--plot", help="Draw plan and outcome, from above.")] = None,
    video: Video = None,
    json: Json = False,
) -> None:
    """Take footsteps: those of a plan, or some that lead to a place."""
    from valor.robot import step_plan
    from valor.robot.description import RobotDescription
    from valor.valorctl import filming, presence, step_picture, stepping

    if (plan is None) == (to is None):
        raise ValorError("expected a plan, or --to X Y YAW")
    file = step_plan.load(plan_file(plan)) if plan is not None else None
    instance = presence.require_running(through_link=True)
    with filming.filmed(instance, video, quiet=json), Interruption() as interruption:
        if file is not None:
            outcome = stepping.step_plan(instance, file.steps, file.frame, interruption.check)
        else:
            assert to is not None
            tell = (lambda text: None) if json else say
            outcome = stepping.step_to(instance, to, relative=relative, check=interruption.check, tell=tell)
    if plot is not None:
        feet = RobotDescription.load(instance.settings().robot).tables.feet
        step_picture.draw(plot, feet, outcome.start, outcome.steps, outcome.end)
    far, turned = outcome.errors
    if json:
        say_json(
            {
                "steps": len(outcome.steps),
                "reached": not outcome.reason,
                "reason": outcome.reason or None,
                "status": outcome.flags,
                "largest_error_m": far,
                "largest_error_rad": turned,
            }
        )
    if outcome.reason:
        raise ValorError(f"the plan did not reach its end: {outcome.reason}")
    if not json:
        say(outcome.describe())
