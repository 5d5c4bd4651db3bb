"""Tab *Drive*: control modes, controllers, walking pad (drawn by ``keys.js``), and walking to a point on the floor."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from functools import partial
from typing import Any

from viser._messages import RunJavascriptMessage

from valor.common.behaviors import STEPPING_MODES, WALKING_MODES, ControlMode
from valor.common.errors import RefusalError, ValorError
from valor.operator_station.commands.log import Command
from valor.operator_station.commands.queue import MOTION, UserEvent
from valor.operator_station.robot.modes import Modes
from valor.operator_station.scene.footfalls import StepPreview, floor_point, sole_poses, walk_to
from valor.operator_station.tabs import Approval, StationContext, bounded, vector

HELD = 0.3  # timeout of a held button [s]

Velocity = tuple[float, float, float]  # forward, left [m/s], turning left [rad/s]

DIRECTIONS: dict[str, Velocity] = {
    "turn left": (0.0, 0.0, 1.0),
    "forward": (1.0, 0.0, 0.0),
    "turn right": (0.0, 0.0, -1.0),
    "left": (0.0, 1.0, 0.0),
    "back": (-1.0, 0.0, 0.0),
    "right": (0.0, -1.0, 0.0),
}
FASTEST: Velocity = (0.4, 0.1, 0.3)  # at full speed [m/s, m/s, rad/s]
STILL: Velocity = (0.0, 0.0, 0.0)


@dataclass
class Pad:
    """Held direction, and ``speed`` as a fraction of ``FASTEST``."""

    speed: float = 0.5
    _direction: str = ""
    _until: float = 0.0
    _moves: bool = False

    def hold(self, direction: str, now: float) -> bool:
        """Note a held button at a monotonic time [s]; return whether it is newly pressed."""
        began = not self._moves or direction != self._direction
        self._direction, self._until, self._moves = direction, now + HELD, True
        return began

    def release(self) -> None:
        """Release all buttons."""
        self._until = 0.0

    def velocity(self, now: float) -> Velocity | None:
        """Return the velocity to send; None if no button is held and zero was sent."""
        if not self._moves:
            return None
        if now >= self._until:
            self._moves = False
            return STILL
        forward, left, turn = DIRECTIONS[self._direction]
        return forward * FASTEST[0] * self.speed, left * FASTEST[1] * self.speed, turn * FASTEST[2] * self.speed


SLOWEST = 0.1  # speed of the pad [fraction]
FARTHEST = 1e4  # of a click [m]
SEND = 0.1  # between velocities [s]
CHOSEN = 6.0  # timeout of a choice, after which the robot's is shown again [s]
NONE = "–"  # while no controller can be chosen
SHOWN = 10.0  # largest displayed age of a velocity [s]


class Drive:
    """Controls of the tab."""

    def __init__(self, parts: StationContext, modes: Modes) -> None:
        client, desk = parts.client, parts.desk
        self._desk, self._commander, self._heard, self._scene = desk, parts.commander, parts.heard, parts.scene
        self._modes = modes
        self.pad = Pad()
        self._client = client
        self._sent = 0.0
        self._way: StepPreview | None = None
        self._going: Command | None = None  # approved plan
        gui = client.gui
        with gui.add_folder("Control mode"):
            self._buttons = {name: gui.add_button(name, disabled=True) for name in modes.names}
            for name, mode in self._buttons.items():
                mode.on_click(desk.taking(partial(self._change, name)))
            self._controller = gui.add_dropdown("controller", (NONE,), disabled=True)
            self._controller.on_update(desk.taking(self._choose))
            self._seen, self._seen_at = NONE, 0.0  # value of the drop-down, and since when [s]
        with gui.add_folder("Walking pad (hold)"):
            self._about_pad = gui.add_markdown("")
            speed = gui.add_slider("speed", SLOWEST, 1.0, 0.1, self.pad.speed)
            speed.on_update(desk.taking(lambda visit: self._set_speed(speed.value)))
            buttons = {direction: gui.add_button(direction, visible=False) for direction in DIRECTIONS}
            for direction, button in buttons.items():
                button.on_hold(desk.taking(partial(self._hold, direction)), callback_hz=10.0)
        self._pad_ids = {direction: button._impl.uuid for direction, button in buttons.items()}  # for keys.js
        self._pad_shown = False
        with gui.add_folder("Walk to a place") as folder:
            self._armed = gui.add_checkbox("click on the floor to plan", False)
            self._told = gui.add_markdown("no place chosen")
            self._approval = Approval(gui, folder, "Walk there", desk)
            gui.add_button("Forget the plan").on_click(desk.taking(lambda visit: self._forget("no place chosen")))
            gui.add_button("Stop walking there").on_click(desk.taking(self._cancel))
        client.scene.on_click()(desk.taking(self._clicked))  # type: ignore[arg-type]  # it takes coroutines, too

    def close(self) -> None:
        """Release the pad, and hide pad and plan."""
        self.pad.release()
        self._scene.preview_steps.show([])
        self._show_pad(False)

    def _show_pad(self, walks: bool) -> None:
        if self._pad_shown is not walks:
            self._pad_shown = walks
            source = f"valorPad({json.dumps(self._pad_ids)}, {json.dumps(walks)})"
            self._client._websock_connection.queue_message(RunJavascriptMessage(source))

    def draw(self) -> None:
        """Show available modes and the progress of the plan."""
        self._show_pad(self._heard.mode.current in WALKING_MODES)
        if self._going:
            self._told.content = self._going.line()
        for name, button in self._buttons.items():
            why = self._why_not(name)
            current = name == self._heard.mode.current
            button.label, button.disabled = f"{name}  ✓" if current else f"{name} – {why}" if why else name, bool(why)
        self._about_pad.content = self._pad_text()
        self._draw_controllers()

    def _draw_controllers(self) -> None:
        shown, (chosen, *others) = self._controller, self._heard.allowed or [NONE]
        if shown.value != self._seen:
            self._seen, self._seen_at = shown.value, time.monotonic()
        waits = time.monotonic() - self._seen_at < CHOSEN
        if shown.options != (options := tuple(sorted((chosen, *others)))):
            shown.options, shown.disabled, waits = options, not others, False
        if shown.value != chosen and not waits:
            shown.value = self._seen = chosen  # type: ignore[misc]  # it has a setter

    def _why_not(self, name: str) -> str:
        return self._modes.why_not(name, self._heard.mode, self._heard.behavior)

    def _pad_text(self) -> str:
        """Why the pad is disabled; with a link, the age of the last received velocity."""
        heard = self._heard
        if heard.mode.current not in WALKING_MODES:
            return f"in control mode {' or '.join(sorted(WALKING_MODES))}; it is {heard.mode.current or 'not known'}"
        if heard.link is None:
            return "below the robot: buttons, W A S D, Q E and arrows"
        age = heard.ages.age("velocity", time.monotonic())
        return f"a velocity came through {age:.1f} s ago" if age < SHOWN else "no velocity has come through lately"

    def turn(self, now: float) -> None:
        """Send the held velocity; ``now`` is monotonic [s]."""
        if now - self._sent < SEND:
            return
        if self._desk.age() > MOTION:
            self.pad.release()
        if (velocity := self.pad.velocity(now)) is not None:
            self._commander.velocity(*velocity)
            self._sent = now

    def _change(self, name: str, visit: UserEvent) -> None:
        command = self._desk.command(visit, f"control mode {name}")
        if why := self._why_not(name):
            command.state, command.answer = "refused", why
            raise RefusalError("mode", command.line())
        self._commander.change_mode(name, command)

    def _choose(self, visit: UserEvent) -> None:
        name = str(visit.event.target.value)
        command = self._desk.command(visit, f"controller {name[:64]}")
        if name not in self._heard.allowed:
            expected = ", ".join(sorted(self._heard.allowed)) or "none"
            command.state, command.answer = "refused", f"expected in {self._heard.behavior} one of {expected}"
            raise RefusalError("controller", command.line())
        self._commander.choose_controller(name, command)

    def _set_speed(self, speed: Any) -> None:
        self.pad.speed = bounded(speed, SLOWEST, 1.0)

    def _hold(self, direction: str, visit: UserEvent) -> None:
        if self._heard.mode.current not in WALKING_MODES:
            raise RefusalError("mode", f"velocities are followed in {' and '.join(sorted(WALKING_MODES))}")
        if visit.age > MOTION:
            self.pad.release()
            raise RefusalError("age", f"{direction} came too late: made up to {visit.age:.1f} s ago")
        if self.pad.hold(direction, time.monotonic()):
            command = self._desk.command(visit, f"walk {direction}, as long as it is held", MOTION)
            command.state = "acknowledged"

    def _clicked(self, visit: UserEvent) -> None:
        if not self._armed.value:
            return
        body = self._scene.body
        soles = sole_poses(body.soles())
        event = visit.event
        origin, direction = vector(event.ray_origin, 3, FARTHEST), vector(event.ray_direction, 3, FARTHEST)
        place = floor_point(origin, direction, min(sole.position[2] for sole in soles))
        if place is None:
            self._forget("that is not on the floor")
            return
        try:
            way = walk_to(body.model.robot, soles, place)
        except ValorError as error:
            self._forget(str(error))
            return
        self._scene.preview_steps.show([(index, foot, sole) for index, (foot, sole) in enumerate(way.steps)])
        self._way = way
        self._approval.offer(lambda visit: self._walk(visit, way), refused=bool(way.faults))
        where = f"{len(way.steps)} steps to ({place[0]:.2f}, {place[1]:.2f}) m in odom"
        self._told.content = where if not way.faults else f"{where}\n\nwould be refused: " + "; ".join(way.faults[:3])

    def _forget(self, why: str) -> None:
        self._way = self._going = None
        self._scene.preview_steps.show([])
        self._approval.offer(None)
        self._told.content = why

    def _walk(self, visit: UserEvent, way: StepPreview) -> None:
        if way is not self._way or way.faults:
            raise RefusalError("plan", "that plan is not shown any more")
        command = self._desk.command(visit, f"{len(way.steps)} steps")
        mode = self._heard.mode.current
        self._forget("on the way")
        self._going = command
        if mode in STEPPING_MODES:
            self._commander.step(way.steps, command)
            return
        if why := self._modes.why_not(ControlMode.STEP, self._heard.mode):
            command.state, command.answer = "refused", f"control mode step: {why}"
            raise RefusalError("mode", command.line())
        first = self._desk.command(visit, "control mode step")
        self._commander.change_mode(ControlMode.STEP, first, then=lambda: self._commander.step(way.steps, command))

    def _cancel(self, visit: UserEvent) -> None:
        command = self._desk.command(visit, "end what runs")
        self._commander.cancel()
        command.state = "acknowledged"
