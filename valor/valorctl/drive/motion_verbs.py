"""``stop``, ``mode``, ``controller``, ``arm``, ``hand``, ``walk``, ``step``, ``get-up``, ``push``, ``time``."""

from typing import Annotated, Any, Literal

import typer

from valor.common.behaviors import LIMBS, NO_LIMB, ControlMode
from valor.common.errors import ValorError, require_one_of
from valor.common.instance import Instance
from valor.common.resources import file_of, names
from valor.valorctl.terminal import completion
from valor.valorctl.terminal.console import Interruption, progress, rich_console, say, say_json
from valor.valorctl.terminal.options import Json

DEFAULT_SECONDS = 5.0  # of a walk
SERVED = 10.0  # until a simulation on a busy computer answers [s]
PUSH_DURATION = 0.1  # [s]
_NUMBERS_MAY_BE_NEGATIVE = {"ignore_unknown_options": True}

_MODE = typer.Argument(help="Control mode to enter; default: show the current one.", autocompletion=completion.modes)
_LIMBS = f"With freeze: only these limbs, the rest goes on: {', '.join(LIMBS)}; repeatable. {NO_LIMB}: release all."
_CONTROLLER = typer.Argument(
    help="Of `controllers` in robot.yaml; default: show all.", autocompletion=completion.controllers
)
_ARM_PRESET = typer.Argument(help="Posture in arm_presets of robot.yaml.", autocompletion=completion.arm_presets)
_HAND_PRESET = typer.Argument(
    help="Posture in hand_presets of robot.yaml: open, close.", autocompletion=completion.hand_presets
)


Side = Literal["left", "right"]
TimeWord = Literal["pause", "resume", "step", "factor"]
Speed = Annotated[float, typer.Option(min=0.01, max=1.0, help="Fraction of the joint speed limits.")]
Tolerance = Annotated[float, typer.Option(min=0.0, help="Final error of each joint, at most [rad].")]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    for verb in (stop, mode, controller, arm, hand, walk):
        app.command()(verb)
    app.command(context_settings=_NUMBERS_MAY_BE_NEGATIVE)(step)
    app.command(context_settings=_NUMBERS_MAY_BE_NEGATIVE)(push)
    app.command("time")(simulated_time)
    app.command(name="get-up")(get_up)


def stop(
    freeze: Annotated[bool, typer.Option("--freeze", help="Lock the joints; a walking robot stops first.")] = False,
    json: Json = False,
) -> None:
    """Stop the robot by all available paths: soft stop if it balances, else lock its joints."""
    from valor.common.stopping import HALT, LOCK
    from valor.valorctl.drive import stopping

    stopping.run(Instance.from_environment(), LOCK if freeze else HALT, json)


def _report(values: dict[str, Any], text: str, failure: str, json: bool) -> None:
    """Print the result of a motion, as JSON or as text; raises ``ValorError`` with a failure."""
    if json:
        say_json(values)
    if failure:
        raise ValorError(failure)
    if not json:
        say(text)


def mode(
    name: Annotated[str | None, _MODE] = None,
    joints: Annotated[list[str] | None, typer.Option(metavar="LIMB", help=_LIMBS)] = None,
    json: Json = False,
) -> None:
    """Show or change the control mode, or freeze limbs while the rest of the robot goes on."""
    from valor.common import mode_names
    from valor.valorctl.drive import control_mode
    from valor.valorctl.instance import running

    if joints and name != ControlMode.FREEZE:
        raise ValorError(f"--joints goes with mode {ControlMode.FREEZE}")
    instance = running.require_running()
    if name is None:
        report = control_mode.report(instance)
        flags = control_mode.flag_names(report.status)
        values = {
            "control_mode": report.current_control_mode,
            "requested": report.requested_control_mode,
            "flags": flags,
            "behavior": report.behavior or None,
        }
        text = (
            f"control mode {report.current_control_mode}, requested {report.requested_control_mode or 'none'} "
            f"({', '.join(flags) or 'no flags'}); behavior {report.behavior or 'unknown'}"
        )
        _report(values, text, "", json)
        return
    require_one_of("control mode", name, list(mode_names.modes()))
    with Interruption() as interruption:
        change = control_mode.change(instance, " ".join((name, *(joints or ()))), check=interruption.check)
    result = {
        "requested": change.requested,
        "control_mode": change.current,
        "reached": change.reached,
        "flags": control_mode.flag_names(change.status),
        "reason": change.reason or None,
        "latency_s": change.latency,
    }
    _report(result, change.describe(), "" if change.reached else change.describe(), json)


def controller(name: Annotated[str | None, _CONTROLLER] = None, json: Json = False) -> None:
    """Show or change the controller that balances the robot while it stands or walks."""
    from valor.valorctl.drive import controller_choice
    from valor.valorctl.instance import running

    instance = running.require_running()
    if name is not None:
        with Interruption() as interruption:
            values, text = controller_choice.change(instance, name, interruption.check)
        _report(values, text, "", json)
    elif json:
        say_json(controller_choice.report(instance).as_json())
    else:
        rich_console().print(controller_choice.report(instance).view())


def arm(
    side: Annotated[Side, typer.Argument(help="Arm to move.")],
    preset: Annotated[str, _ARM_PRESET],
    speed: Speed = 0.5,
    tolerance: Tolerance = 0.05,
    json: Json = False,
) -> None:
    """Move an arm to a preset posture and report the final error."""
    _move(side, "arm", preset, speed=speed, tolerance=tolerance, json=json)


def hand(
    side: Annotated[Side, typer.Argument(help="Hand to move.")],
    preset: Annotated[str, _HAND_PRESET],
    speed: Speed = 0.5,
    tolerance: Tolerance = 0.05,
    json: Json = False,
) -> None:
    """Open or close a hand and report the final error."""
    _move(side, "hand", preset, speed=speed, tolerance=tolerance, json=json)


def _move(side: Side, limb: Literal["arm", "hand"], name: str, *, speed: float, tolerance: float, json: bool) -> None:
    from valor.valorctl.drive import arm_motion
    from valor.valorctl.instance import running

    with Interruption() as interruption:
        motion = arm_motion.move_limb(
            running.require_running(), side, limb, name, speed=speed, tolerance=tolerance, check=interruption.check
        )
    values = {
        "side": side,
        "preset": name,
        "duration_s": motion.duration,
        "arrived": motion.arrived,
        "worst_joint": motion.worst_joint,
        "worst_error_rad": motion.worst_error,
        "tolerance_rad": motion.tolerance,
    }
    failure = "" if motion.arrived else f"{side} {limb} did not reach {name}: {motion.describe()}"
    _report(values, f"{side} {limb} in {name} after {motion.duration:.1f} s; {motion.describe()}", failure, json)


def walk(
    *,
    vx: Annotated[float, typer.Option("--vx", help="Forward velocity [m/s].")] = 0.0,
    vy: Annotated[float, typer.Option("--vy", help="Velocity to the left [m/s].")] = 0.0,
    wz: Annotated[float, typer.Option("--wz", help="Turn rate to the left [rad/s].")] = 0.0,
    seconds: Annotated[
        float | None, typer.Option("--for", help="Duration, at most [robot time, s]; default 5 without a distance.")
    ] = None,
    distance: Annotated[float | None, typer.Option("--distance", help="Distance [m].")] = None,
    straight: Annotated[bool, typer.Option("--straight", help="Keep the line and heading of the start.")] = False,
    json: Json = False,
) -> None:
    """Walk at a velocity, stop, and report distance and balance."""
    from valor.valorctl.drive import walking
    from valor.valorctl.instance import running

    if seconds is None and distance is None:
        seconds = DEFAULT_SECONDS
    request = walking.WalkRequest(vx, vy, wz, seconds, distance, straight)
    instance = running.require_running()
    with progress() as shown, Interruption() as interruption:
        result = walking.walk(
            instance,
            request,
            interruption.check,
            lambda passed, way: shown.waiting(f"{passed:.0f} s, {way:.1f} m"),
        )
    values = {
        "distance_m": result.distance,
        "offset_m": result.offset,
        "turned_rad": result.turned,
        "duration_s": result.duration,
        "fell": result.fell,
        "reason": result.reason or None,
        "mean_dcm_error_m": result.dcm_error,
    }
    _report(values, f"walked {result.describe()}", result.failure, json)


def step(
    plan: Annotated[
        str | None,
        typer.Argument(help=f"Plan file, or one of {', '.join(names('plan'))}.", autocompletion=completion.plans),
    ] = None,
    *,
    to: Annotated[
        tuple[float, float, float] | None,
        typer.Option("--to", metavar="X Y YAW", help="Goal of the middle of the feet in odom [m, m, rad]."),
    ] = None,
    relative: Annotated[bool, typer.Option("--relative", help="--to is relative to the robot.")] = False,
    json: Json = False,
) -> None:
    """Take the footsteps of a plan, or step to a goal."""
    from valor.robot import step_plan
    from valor.valorctl.drive import stepping
    from valor.valorctl.instance import running

    if (plan is None) == (to is None):
        raise ValorError("no steps: expected a plan, or --to X Y YAW")
    file = step_plan.load(file_of("plan", plan)) if plan is not None else None
    instance = running.require_running()
    with Interruption() as interruption:
        if file is not None:
            result = stepping.step_plan(instance, file.steps, file.frame, interruption.check)
        else:
            assert to is not None
            result = stepping.step_to(instance, to, relative=relative, check=interruption.check)
    values = {
        "steps": result.steps,
        "reached": not result.reason,
        "reason": result.reason or None,
        "status": result.flags,
        "largest_error_m": result.distance,
        "largest_error_rad": result.angle,
    }
    failure = f"the plan was not completed: {result.reason}" if result.reason else ""
    _report(values, result.describe(), failure, json)


def push(
    x: Annotated[float, typer.Argument(help="Forward impulse [N·s], in world axes.")],
    y: Annotated[float, typer.Argument(help="Impulse to the left [N·s].")],
    z: Annotated[float, typer.Argument(help="Upward impulse [N·s].")],
    body: Annotated[str, typer.Option(help="Body of the model; default the chest.")] = "",
) -> None:
    """Push the simulated robot for 0.1 s."""
    import numpy as np

    from valor.common.messages import PushRequest
    from valor.common.topics import PUSH
    from valor.valorctl.drive.node import request
    from valor.valorctl.instance import running

    wanted = PushRequest(impulse_in_world=np.array((x, y, z)), duration=PUSH_DURATION, body=body)
    needs = "only a simulated robot can be pushed"
    reply = request(running.require_running(), PUSH, wanted, timeout=SERVED, action="push", needs=needs)
    say(f"pushed with ({x:g}, {y:g}, {z:g}) N·s at {reply.time * 1e-9:.3f} s of robot time")


def simulated_time(
    wanted: Annotated[TimeWord, typer.Argument(help="Action.")],
    value: Annotated[
        float, typer.Argument(help="step: control periods; factor: of wall time, 0: as fast as possible.")
    ] = 1.0,
) -> None:
    """Pause, resume, single-step or slow down simulated time."""
    from valor.common.messages import TimeRequest
    from valor.common.topics import SIMULATED_TIME
    from valor.valorctl.drive.node import request
    from valor.valorctl.instance import running

    message, needs = TimeRequest(wanted, value), "only simulated time can be controlled"
    reply = request(running.require_running(), SIMULATED_TIME, message, timeout=SERVED, action=wanted, needs=needs)
    say(f"{'paused' if reply.paused else 'passing'} at {reply.time * 1e-9:.3f} s, factor {reply.factor:g}")


def get_up(json: Json = False) -> None:
    """Get up after a fall; ends in stand_prep."""
    from valor.valorctl.drive import getting_up
    from valor.valorctl.instance import running

    instance = running.require_running()
    with progress() as shown, Interruption() as interruption:
        duration = getting_up.get_up(instance, interruption.check, shown.waiting if json else shown.stage)
    _report({"duration_s": duration}, f"up again after {duration:.1f} s; stand_prep", "", json)
