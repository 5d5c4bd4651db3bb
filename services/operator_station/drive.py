"""The tab that moves the robot as a whole: control modes, the walking pad, and a click on the floor."""

from __future__ import annotations

import time
from typing import Any

from valor.common.behaviors import STEPPING_MODES, WALKING_MODES, ControlMode
from valor.common.errors import RefusalError, ValorError
from valor.operator_station.commands import Command
from valor.operator_station.desk import Visit
from valor.operator_station.footfalls import StepPreview, floor_point, sole_poses, walk_to
from valor.operator_station.heartbeat import MOTION
from valor.operator_station.mode_buttons import ModeButtons
from valor.operator_station.modes import Modes
from valor.operator_station.pad import DIRECTIONS, Pad
from valor.operator_station.parts import Parts

SEND = 0.1  # between velocities [s]
SHOWN = 10.0  # so long is the age of the last velocity told [s]


class Drive:
    """Its buttons, and what they do."""

    def __init__(self, parts: Parts, modes: Modes) -> None:
        server, desk = parts.server, parts.desk
        self._desk, self._commander, self._heard, self._scene = desk, parts.commander, parts.heard, parts.scene
        self._modes = modes
        self.pad = Pad()
        desk.gone.append(self.pad.release)
        self._sent = 0.0
        self._way: StepPreview | None = None
        self._going: Command | None = None  # what became of the plan that was approved is told
        gui = server.gui
        with gui.add_folder("Control mode"):
            self._buttons = ModeButtons(gui, modes, lambda name: desk.taking(self._changing(name)))
        with gui.add_folder("Walking pad (hold)"):
            self._about_pad = gui.add_markdown("")
            speed = gui.add_slider("speed", 0.1, 1.0, 0.1, self.pad.speed)
            speed.on_update(desk.taking(lambda visit: self._set_speed(float(speed.value))))
            for direction in DIRECTIONS:
                gui.add_button(direction).on_hold(desk.taking(self._holding(direction)), callback_hz=10.0)
        with gui.add_folder("Walk to a place"):
            self._armed = gui.add_checkbox("click on the floor to plan", False)
            self._told = gui.add_markdown("no place chosen")
            self._go = gui.add_button("Walk there", disabled=True, color="green")
            self._go.on_click(desk.taking(self._walk))
            gui.add_button("Forget the plan").on_click(desk.taking(lambda visit: self._forget("no place chosen")))
            gui.add_button("Stop walking there").on_click(desk.taking(self._cancel))
        server.scene.on_click()(desk.taking(self._clicked))  # type: ignore[arg-type]  # it takes coroutines, too

    def draw(self) -> None:
        """Say what may be asked for, and how far it is with what was."""
        if self._going and self._told.content != (line := self._going.line()):
            self._told.content = line
        mode = self._heard.mode
        self._buttons.show(mode, self._heard.states.get("behavior", ""))
        if self._about_pad.content != (text := self._pad_text()):
            self._about_pad.content = text

    def _pad_text(self) -> str:
        """Why the pad does nothing; else, behind the link, whether velocities come through, which nothing answers."""
        heard = self._heard
        if heard.mode.current not in WALKING_MODES:
            return f"in control mode {' or '.join(sorted(WALKING_MODES))}; it is {heard.mode.current or 'not known'}"
        if heard.link is None:
            return ""
        age = heard.ages.age("velocity", time.monotonic())
        return f"a velocity came through {age:.1f} s ago" if age < SHOWN else "no velocity has come through lately"

    def turn(self, now: float) -> None:
        """Send what is held; ``now``: monotonic [s]."""
        if now - self._sent < SEND:
            return
        if self._desk.age() > MOTION:  # the operator is gone, or hardly to be heard
            self.pad.release()
        if (velocity := self.pad.velocity(now)) is not None:
            self._commander.velocity(*velocity)
            self._sent = now

    def _changing(self, name: str) -> Any:
        def change(visit: Visit) -> None:
            command = self._desk.command(visit, f"control mode {name}")
            if why := self._modes.why_not(name, self._heard.mode, self._heard.states.get("behavior", "")):
                command.state, command.answer = "refused", why
                raise RefusalError("mode", command.line())
            self._commander.change_mode(name, command)

        return change

    def _set_speed(self, speed: float) -> None:
        self.pad.speed = speed

    def _holding(self, direction: str) -> Any:
        def hold(visit: Visit) -> None:
            self._desk.lease.require(visit.viewer)
            if self._heard.mode.current not in WALKING_MODES:
                raise RefusalError("mode", f"velocities are followed in {' and '.join(sorted(WALKING_MODES))}")
            if visit.age > MOTION:
                self.pad.release()
                raise RefusalError("age", f"{direction} came too late: made up to {visit.age:.1f} s ago")
            if self.pad.hold(direction, time.monotonic()):
                command = self._desk.command(visit, f"walk {direction}, as long as it is held", MOTION)
                command.state = "acknowledged"

        return hold

    def _clicked(self, visit: Visit) -> None:
        if not self._armed.value:
            return
        self._desk.lease.require(visit.viewer)
        body = self._scene.body
        soles = sole_poses(body.soles())
        event = visit.event
        place = floor_point(event.ray_origin, event.ray_direction, min(sole.position[2] for sole in soles))
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
        self._go.disabled = bool(way.faults)
        where = f"{len(way.steps)} steps to ({place[0]:.2f}, {place[1]:.2f}) m in odom"
        self._told.content = where if not way.faults else f"{where}\n\nwould be refused: " + "; ".join(way.faults[:3])

    def _forget(self, why: str) -> None:
        self._way = self._going = None
        self._scene.preview_steps.show([])
        self._go.disabled = True
        self._told.content = why

    def _walk(self, visit: Visit) -> None:
        way = self._way
        if way is None:
            raise RefusalError("plan", "no plan is shown")
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

    def _cancel(self, visit: Visit) -> None:
        command = self._desk.command(visit, "end what runs")
        self._commander.cancel()
        command.state = "acknowledged"
