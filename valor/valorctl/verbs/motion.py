"""``stop``, ``mode``, ``arm``, ``hand``, ``walk``, ``push``, ``get-up``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from valor.common.errors import ValorError, require_one_of
from valor.common.instance import Instance
from valor.valorctl import completion
from valor.valorctl.console import progress, say, say_json, say_rows
from valor.valorctl.interruption import Interruption
from valor.valorctl.verbs.options import Json, Video

if TYPE_CHECKING:
    from valor.valorctl.walking import Walk

DEFAULT_SECONDS = 5.0  # of a walk
_NUMBERS_MAY_BE_NEGATIVE = {"ignore_unknown_options": True}


_MODE = typer.Argument(help="The control mode to go to; shown unless given.", autocompletion=completion.modes)
_ARM_PRESET = typer.Argument(help="A posture of robot.yaml's arm_presets.", autocompletion=completion.arm_presets)
_HAND_PRESET = typer.Argument(
    help="A posture of robot.yaml's hand_presets: open, close.", autocompletion=completion.hand_presets
)


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command()(stop)
    app.command()(mode)
    app.command()(arm)
    app.command()(hand)
    app.command()(walk)
    app.command(context_settings=_NUMBERS_MAY_BE_NEGATIVE)(push)
    app.command("time")(simulated_time)
    app.command(name="get-up")(get_up)


def stop(
    freeze: Annotated[
        bool, typer.Option("--freeze", help="Lock the joints; a robot that walks comes to stand before.")
    ] = False,
    json: Json = False,
) -> None:
    """Stop the robot, by every path there is: it keeps its balance where it has one, else its joints are locked."""
    from valor.common.stopping import HALT, LOCK
    from valor.valorctl import stopping

    stopping.run(Instance.from_environment(), LOCK if freeze else HALT, json)


def mode(
    name: Annotated[str | None, _MODE] = None,
    json: Json = False,
) -> None:
    """Show the control mode, or change it."""
    from valor.common import mode_names
    from valor.valorctl import control_mode, presence

    instance = presence.require_running(through_link=True)
    if name is None:
        report, age = control_mode.aged_report(instance)
        flags = control_mode.flag_names(report.status)
        if json:
            say_json(
                {
                    "control_mode": report.current_control_mode,
                    "requested": report.requested_control_mode,
                    "flags": flags,
                    "behavior": report.behavior or None,
                    "age_s": age,
                }
            )
        else:
            say(
                f"control mode {report.current_control_mode}, asked for {report.requested_control_mode or 'nothing'} "
                f"({', '.join(flags) or 'no flags'}); behavior {report.behavior or 'not known'}"
                + (f"; {age:.1f} s old at most" if age else "")
            )
        return
    require_one_of("control mode", name, mode_names.names())
    with Interruption() as interruption:
        change = control_mode.change(instance, name, check=interruption.check)
    if json:
        say_json(
            {
                "requested": change.requested,
                "control_mode": change.current,
                "reached": change.reached,
                "flags": control_mode.flag_names(change.status),
                "reason": change.reason or None,
                "latency_s": change.latency,
            }
        )
    if not change.reached:
        raise ValorError(change.describe())
    if not json:
        say(change.describe())


Side = Literal["left", "right"]
TimeWord = Literal["pause", "resume", "step", "factor"]
Speed = Annotated[float, typer.Option(min=0.01, max=1.0, help="Fraction of the joint speed limits to use at most.")]
Tolerance = Annotated[float, typer.Option(min=0.0, help="For the final error of each joint [rad].")]


def arm(
    side: Annotated[Side, typer.Argument(help="Which arm.")],
    preset: Annotated[str, _ARM_PRESET],
    speed: Speed = 0.5,
    tolerance: Tolerance = 0.05,
    json: Json = False,
) -> None:
    """Move an arm to a preset posture and measure how well it got there."""
    _move(side, "arm", preset, speed=speed, tolerance=tolerance, json=json)


def hand(
    side: Annotated[Side, typer.Argument(help="Which hand.")],
    preset: Annotated[str, _HAND_PRESET],
    speed: Speed = 0.5,
    tolerance: Tolerance = 0.05,
    json: Json = False,
) -> None:
    """Open or close a hand and measure how well it got there."""
    _move(side, "hand", preset, speed=speed, tolerance=tolerance, json=json)


def _move(side: Side, limb: Literal["arm", "hand"], name: str, *, speed: float, tolerance: float, json: bool) -> None:
    from valor.valorctl import arm_motion, presence

    instance = presence.require_running(through_link=True)
    with Interruption() as interruption:
        motion = arm_motion.move_limb(
            instance, side, limb, name, speed=speed, tolerance=tolerance, check=interruption.check
        )
    if json:
        say_json(
            {
                "side": side,
                "preset": name,
                "duration_s": motion.duration,
                "arrived": motion.arrived,
                "worst_joint": motion.worst_joint,
                "worst_error_rad": motion.worst_error,
                "tolerance_rad": motion.tolerance,
            }
        )
    if not motion.arrived:
        raise ValorError(f"{side} {limb} did not reach {name}: {motion.describe()}")
    if not json:
        say(f"{side} {limb} in {name} after {motion.duration:.1f} s; {motion.describe()}")


def walk(
    *,
    vx: Annotated[float, typer.Option("--vx", help="Forward [m/s].")] = 0.0,
    vy: Annotated[float, typer.Option("--vy", help="To the left [m/s].")] = 0.0,
    wz: Annotated[float, typer.Option("--wz", help="Turning to the left [rad/s].")] = 0.0,
    seconds: Annotated[
        float | None, typer.Option("--for", help="At most so long [robot time, s]; 5 unless a distance is given.")
    ] = None,
    distance: Annotated[float | None, typer.Option("--distance", help="Until it has gone so far [m].")] = None,
    straight: Annotated[
        bool, typer.Option("--straight", help="Keep to the line and the heading it starts with.")
    ] = False,
    plot: Annotated[Path | None, typer.Option("--plot", help="Draw the way, the balance, the feet's forces.")] = None,
    video: Video = None,
    json: Json = False,
) -> None:
    """Walk at a velocity, stop, and say how far it went."""
    from valor.valorctl import filming, presence, walking

    if seconds is None and distance is None:
        seconds = DEFAULT_SECONDS
    order = walking.Order(vx, vy, wz, seconds, distance, straight)
    instance = presence.require_running()
    with filming.filmed(instance, video, quiet=json), progress() as shown, Interruption() as interruption:
        result = walking.walk(
            instance,
            order,
            interruption.check,
            lambda passed, way: shown.waiting(f"{passed:.0f} s, {way:.1f} m"),
        )
    if json:
        say_json(
            {
                "distance_m": result.distance,
                "offset_m": result.offset,
                "turned_rad": result.turned,
                "duration_s": result.duration,
                "fell": result.fell,
                "reason": result.reason or None,
                "mean_dcm_error_m": result.dcm_error,
                "longest_pause_s": result.pause,
                **(result.report.named() if result.report else {}),
            }
        )
    elif result.report:
        say_rows(result.report.rows())
    if plot is not None:
        _draw(result, plot)
    if result.reason:
        raise ValorError(f"walked {result.describe()}, then {result.reason}")
    if not json:
        say("; ".join([f"walked {result.describe()}", *([f"picture: {plot}"] if plot else [])]))


def _draw(walked: Walk, file: Path) -> None:
    """Write the picture of a walk.

    Raises:
        ValorError: nothing was measured, or it cannot be written.
    """
    from valor.analysis import track_plot

    if walked.track is None:
        raise ValorError(f"{file}: nothing was measured to draw")
    try:
        track_plot.draw(walked.track, file, walked.describe())
    except (OSError, ValueError) as error:
        raise ValorError(f"{file}: the picture cannot be written: {error}") from None


def push(
    x: Annotated[float, typer.Argument(help="Forward [N·s], in the world's axes.")],
    y: Annotated[float, typer.Argument(help="To the left [N·s].")],
    z: Annotated[float, typer.Argument(help="Up [N·s].")],
    body: Annotated[str, typer.Option(help="Of the robot's model; the chest unless given.")] = "",
) -> None:
    """Push the simulated robot for 0.1 s."""
    from valor.valorctl import presence, requests

    instance = presence.require_running()
    reply = requests.push(instance, (x, y, z), body)
    say(f"pushed with ({x:g}, {y:g}, {z:g}) N·s at {reply.time * 1e-9:.3f} s of robot time")


def simulated_time(
    wanted: Annotated[TimeWord, typer.Argument(help="What is to become of it.")],
    value: Annotated[
        float, typer.Argument(help="step: control periods; factor: of the wall's time, 0 as fast as it goes.")
    ] = 1.0,
) -> None:
    """Pause a simulated robot's time, let it go on or make single steps, or slow it down."""
    from valor.valorctl import presence, requests

    reply = requests.simulated_time(presence.require_running(), wanted, value)
    say(f"{'paused' if reply.paused else 'passing'} at {reply.time * 1e-9:.3f} s, factor {reply.factor:g}")


def get_up(*, video: Video = None, json: Json = False) -> None:
    """Get up after a fall; the robot ends in stand_prep."""
    from valor.valorctl import filming, getting_up, presence

    instance = presence.require_running()
    with (
        filming.filmed(instance, video, quiet=json),
        progress() as shown,
        Interruption() as interruption,
    ):
        duration = getting_up.get_up(instance, interruption.check, shown.waiting if json else shown.stage)
    if json:
        say_json({"duration_s": duration})
    else:
        say(f"up again after {duration:.1f} s; stand_prep")
