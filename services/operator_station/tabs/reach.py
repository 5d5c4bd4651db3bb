"""Tab *Arms*: goals of arms, hands and neck, previewed and then approved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco
import numpy as np

from valor.common.errors import RefusalError
from valor.common.poses import Pose
from valor.operator_station.commands.log import Command
from valor.operator_station.commands.queue import UserEvent
from valor.operator_station.tabs import Approval, StationContext, bounded, vector
from valor.operator_station.tabs.preview import Preview, Previewer
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.tables import Presets, Side

SPEED = 0.4  # fraction of the commanded joint speeds
SHORTEST = 1.0  # [s]
FARTHEST = 100.0  # goal of a hand, along an axis of odom [m]
_QUINTIC_PEAK = 15.0 / 8.0  # peak over mean speed of a quintic from rest to rest


@dataclass(frozen=True)
class _Goal:
    """Previewed goal; ``execute`` sends it."""

    text: str
    preview: Preview
    execute: Callable[[Command], None]


class Reach:
    """Controls of the tab."""

    def __init__(self, parts: StationContext, previewer: Previewer) -> None:
        desk, gui = parts.desk, parts.client.gui
        self._client, self._desk, self._commander = parts.client, desk, parts.commander
        self._heard, self._scene, self._previewer = parts.heard, parts.scene, previewer
        self._robot: RobotDescription = parts.scene.body.model.robot
        self._goal: _Goal | None = None
        self._gizmos: dict[Side, Any] = {}
        tables = self._robot.tables
        with gui.add_folder("Preview, then approve") as folder:
            self._told = gui.add_markdown("nothing is previewed")
            self._approval = Approval(gui, folder, "Approve and execute", desk)
            gui.add_button("Forget it").on_click(desk.taking(lambda visit: self._forget("nothing is previewed")))
        with gui.add_folder("Arm presets"):
            self._offer_presets("arm", tables.arm_presets)
        with gui.add_folder("Hand goals (drag)"):
            for side, hand in tables.hands.present():
                if tables.group(f"{side}_arm"):
                    self._offer(side, hand.site)
        with gui.add_folder("Hands"):
            self._offer_presets("hand", tables.hand_presets)
        if tables.group("neck"):
            self._add_neck()

    def _offer_presets(self, limb: str, presets: Presets) -> None:
        for name, sides in presets.items():
            for side, goal in sides.items():
                button = self._client.gui.add_button(f"{side} {limb}: {name}")
                button.on_click(self._desk.taking(partial(self._choose, f"{side}_{limb}", name, goal)))

    def _add_neck(self) -> None:
        gui, names = self._client.gui, self._robot.tables.group("neck")
        limits = CommandedLimits.of_joints(self._robot).select(self._robot.group_indices("neck"))
        with gui.add_folder("Neck"):
            sliders = []
            for name, lower, upper in zip(names, limits.lower.tolist(), limits.upper.tolist(), strict=True):
                low, high = max(lower, -1.5), min(upper, 1.5)
                sliders.append(gui.add_slider(name, round(low, 2), round(high, 2), 0.01, min(max(0.0, low), high)))

            def look(visit: UserEvent) -> None:
                goal = {name: bounded(s.value, s.min, s.max) for name, s in zip(names, sliders, strict=True)}
                self._choose("neck", "as the sliders say", goal, visit)

            gui.add_button("Preview the neck").on_click(self._desk.taking(look))

    def _offer(self, side: Side, site: str) -> None:
        gui, desk = self._client.gui, self._desk
        gizmo = self._client.scene.add_transform_controls(
            f"/hand_goal/{side}", scale=0.22, visible=False, depth_test=False
        )
        self._gizmos[side] = gizmo
        shown = gui.add_checkbox(f"{side} hand's goal", False)

        def show(visit: UserEvent) -> None:
            position, turn = self._scene.body.site(site)
            gizmo.position, gizmo.wxyz = position, _quaternion(turn)
            gizmo.visible = bool(shown.value)

        shown.on_update(desk.taking(show))
        gizmo.on_update(desk.taking(lambda visit: self._dragged(visit, side)))
        gui.add_button(f"Let the {side} hand go").on_click(desk.taking(lambda visit: self._release(visit, side)))

    def _dragged(self, visit: UserEvent, side: Side) -> None:
        """Preview a moved goal when the mouse is released."""
        if getattr(visit.event, "phase", "end") != "end":
            return
        gizmo = self._gizmos[side]
        position, quaternion = np.array(vector(gizmo.position, 3, FARTHEST)), np.array(vector(gizmo.wxyz, 4, 1.0))
        if mujoco.mju_normalize4(quaternion) < 0.5:
            raise RefusalError("value", "the hand's goal has no orientation")
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, quaternion)
        preview = self._previewer.hand(self._scene.body, side, position, turn.reshape(3, 3), self._heard.contacts)
        pose = Pose(tuple(position.tolist()), tuple(quaternion.tolist()))
        x, y, z = position.tolist()
        text = f"{side} hand to ({x:.2f}, {y:.2f}, {z:.2f}) m in odom"
        self._show(_Goal(text, preview, lambda command: self._commander.lead_hand(side, pose, command)))

    def _release(self, visit: UserEvent, side: Side) -> None:
        self._commander.release_hand(side, self._desk.command(visit, f"let the {side} hand go"))

    def _choose(self, group: str, name: str, preset: Mapping[str, float], visit: UserEvent) -> None:
        body = self._scene.body
        now = {joint: float(body.joints[self._robot.index[joint]]) for joint in self._robot.tables.group(group)}
        goal = now | dict(preset)  # the controller needs all joints
        duration = self._duration(now, goal)
        preview = self._previewer.arm(body, goal, self._heard.contacts)
        text = f"{group.replace('_', ' ')} {name}, in {duration:.1f} s"
        self._show(_Goal(text, preview, lambda command: self._commander.follow(group, goal, duration, command)))

    def _duration(self, now: Mapping[str, float], goal: Mapping[str, float]) -> float:
        velocity = CommandedLimits.of_joints(self._robot).velocity
        slowest = max(
            abs(goal[name] - now[name]) * _QUINTIC_PEAK / (SPEED * velocity[self._robot.index[name]]) for name in goal
        )
        return max(SHORTEST, float(slowest))

    def _show(self, goal: _Goal) -> None:
        self._goal = goal
        faults = goal.preview.faults
        self._scene.preview(goal.preview.joints, bool(faults))
        self._approval.offer(lambda visit: self._execute(visit, goal), refused=bool(faults))
        verdict = "would be refused: " + "; ".join(faults) if faults else "nothing speaks against it"
        self._told.content = f"**{goal.text}**\n\n{verdict}"

    def _forget(self, why: str) -> None:
        self._goal = None
        self._scene.preview({}, False)
        self._approval.offer(None)
        self._told.content = why

    def close(self) -> None:
        """Hide the preview."""
        self._scene.preview({}, False)
        for gizmo in self._gizmos.values():
            gizmo.remove()

    def _execute(self, visit: UserEvent, goal: _Goal) -> None:
        if goal is not self._goal or goal.preview.faults:
            raise RefusalError("preview", "that goal is not previewed any more")
        command = self._desk.command(visit, goal.text)
        self._forget(f"{goal.text}: approved")
        goal.execute(command)


def _quaternion(turn: Any) -> Any:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(turn).ravel())
    return quaternion
