"""Soles, contact forces, support polygon, CoM, DCM, CoP and footsteps; grey if old."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from viser import SceneApi

from valor.common.arrays import FloatArray
from valor.common.poses import Pose
from valor.drawing import marks
from valor.drawing.marks import rgb
from valor.operator_station.robot.snapshot import RobotSnapshot
from valor.operator_station.scene.body import Body
from valor.operator_station.scene.footfalls import sole_corners
from valor.ros.limbs import FEET

Color = tuple[int, int, int]

GREY: Color = (150, 150, 150)
LEFT, RIGHT, POLYGON, FORCE = (rgb(color) for color in (marks.LEFT, marks.RIGHT, marks.SUPPORT, marks.FORCE))
RADII = {"com": 0.025, "dcm": 0.022, "dcm_reference": 0.016, "cop": 0.022}  # [m]
POINTS = {name: (rgb(color), RADII[name]) for name, color in marks.BALANCE.items()}
LABELS = {"com": 0.06, "dcm": 0.06, "dcm_reference": 0.14, "cop": 0.22}  # height of a label over its point [m]
FORCE_SCALE = 1.0 / 1000.0  # [m/N]
ABOVE = 0.004  # of marks over the floor [m]
_STILL = 1e-3  # largest change that is not sent [m]
_EDGES = 12  # of the support polygon at most: two soles have eight corners


class Overlays:
    """All overlays but footsteps."""

    def __init__(self, scene: SceneApi, body: Body) -> None:
        self._scene, self._robot = scene, body.model.robot
        self._soles = [
            scene.add_line_segments(f"/soles/{name}", np.zeros((4, 2, 3), np.float32), color, thickness=0.008)
            for name, color in (("left", LEFT), ("right", RIGHT))
        ]
        self._polygon = scene.add_line_segments(
            "/support_polygon", np.zeros((_EDGES, 2, 3), np.float32), POLYGON, thickness=0.012
        )
        self._forces = scene.add_arrows(
            "/contact_forces", np.zeros((2, 2, 3), np.float32), FORCE,
            shaft_radius=0.008, head_radius=0.02, head_length=0.04,
        )  # fmt: skip
        self._points = {
            name: scene.add_icosphere(f"/points/{name}", radius, color, subdivisions=2, cast_shadow=False)
            for name, (color, radius) in POINTS.items()
        }
        for name, height in LABELS.items():
            scene.add_label(f"/points/{name}/label", name.replace("_", " "), position=(0.0, 0.0, height))

    def draw(self, heard: RobotSnapshot, body: Body, now: float) -> None:
        """Update; ``now`` is monotonic [s]."""
        for place, ((position, turn), handle) in enumerate(zip(body.soles(), self._soles, strict=True)):
            corners = sole_corners(self._robot, place, position, turn)
            _move(handle, _ring(corners))
            _tint(handle, (LEFT, RIGHT)[place], not heard.contacts[place] or heard.ages.old("joints", now))
        hull = body.support(heard.contacts)
        floor = min(float(position[2]) for position, _ in body.soles()) + ABOVE
        ring = np.zeros((_EDGES, 2, 3))
        if len(hull):
            edges = _ring(np.column_stack((hull, np.full(len(hull), floor))))[:_EDGES]
            ring[: len(edges)] = edges
            ring[len(edges) :] = edges[0, 0]
        _move(self._polygon, ring)
        _tint(self._polygon, POLYGON, heard.ages.old("joints", now))
        self._draw_forces(heard, body, now)
        self._draw_points(heard, floor, now)

    def _draw_forces(self, heard: RobotSnapshot, body: Body, now: float) -> None:
        arrows = np.zeros((2, 2, 3))
        for place, ((position, turn), name) in enumerate(zip(body.soles(), FEET, strict=True)):
            arrows[place] = position
            if (wrench := heard.wrenches.get(name)) is not None:
                arrows[place] = force_arrow(wrench, position, turn)
        _move(self._forces, arrows)
        _tint(self._forces, FORCE, heard.ages.old(FEET[0], now))

    def _draw_points(self, heard: RobotSnapshot, floor: float, now: float) -> None:
        for name, handle in self._points.items():
            point = heard.points.get(name)
            handle.visible = point is not None and bool(np.isfinite(point[:2]).all())
            if not handle.visible or point is None:
                continue
            # The DCM and the CoP are looked at on the floor; the CoM hangs where it is.
            place = point if name == "com" else np.array((point[0], point[1], floor))
            if np.abs(place - handle.position).max() > _STILL:
                handle.position = place
            _tint(handle, POINTS[name][0], heard.ages.old(name, now))


class Footprints:
    """One set of numbered soles on the floor."""

    def __init__(self, scene: SceneApi, name: str, body: Body, opacity: float) -> None:
        self._scene, self._name, self._robot, self._opacity = scene, name, body.model.robot, opacity
        self._shown: list[tuple[int, int, Pose]] = []
        self._handles: list[Any] = []

    def show(self, steps: Sequence[tuple[int, int, Pose]]) -> None:
        """Show number, foot (0 left, 1 right) and sole in odom of each step."""
        if list(steps) == self._shown:
            return
        for handle in self._handles:
            handle.remove()
        self._shown, self._handles = list(steps), []
        for index, foot, sole in steps:
            corners = sole_corners(self._robot, foot, np.array(sole.position), np.array(sole.rotation))
            corners[:, 2] += ABOVE
            path = f"/{self._name}/{index}"
            self._handles.append(
                self._scene.add_mesh_simple(
                    path, corners.astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
                    color=(LEFT, RIGHT)[foot], opacity=self._opacity, side="double",
                    cast_shadow=False, receive_shadow=False,
                )
            )  # fmt: skip
            x, y, z = sole.position
            self._handles.append(self._scene.add_label(f"{path}_number", str(index), position=(x, y, z + 0.03)))


def force_arrow(wrench: FloatArray, position: FloatArray, turn: FloatArray) -> FloatArray:
    """Return (2, 3) [m]: centre of pressure, and end of the arrow along the ground force.

    ``wrench`` is (6,) in the sole's frame [N, N·m]; ``position`` (3,) [m] and ``turn`` (3, 3) are of the sole in odom.
    """
    force, torque = wrench[:3], wrench[3:]
    centre = np.zeros(3)
    if force[2] > 20.0:  # the centre of a smaller force is inaccurate
        centre[:2] = -torque[1] / force[2], torque[0] / force[2]
    start = position + turn @ centre
    return np.stack((start, start + FORCE_SCALE * (turn @ force)))


def _move(handle: Any, points: FloatArray) -> None:
    """Send changed points only."""
    if np.abs(points - handle.points).max() > _STILL:
        handle.points = points.astype(np.float32)


def _tint(handle: Any, color: Color, old: bool) -> None:
    """Set the color, or grey."""
    shown = GREY if old else color
    if hasattr(handle, "colors"):
        handle.colors = np.broadcast_to(np.array(shown, np.uint8), handle.colors.shape)
    else:
        handle.color = shown


def _ring(corners: FloatArray) -> FloatArray:
    """(k, 2, 3) edges around (k, 3) corners."""
    ring: FloatArray = np.stack((corners, np.roll(corners, -1, axis=0)), axis=1)
    return ring
