"""The tab of what a simulation alone has: its time is paused, stepped and slowed down, and its robot pushed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import RefusalError
from valor.common.linking import behind
from valor.common.messages import PushRequest, TimeRequest
from valor.common.topics import CLOCK, PAUSED, PUSH, SIMULATED_TIME
from valor.operator_station.body import Body
from valor.operator_station.desk import Visit
from valor.operator_station.parts import Parts
from valor.operator_station.worker import Worker
from valor.service import Context

STRONGEST = 60.0  # push that is offered [N·s]
PUSHES = {"forward": (1.0, 0.0), "back": (-1.0, 0.0), "to the left": (0.0, 1.0), "to the right": (0.0, -1.0)}
DURATION = 0.1  # of a push [s]
FACTORS = ("0.05", "0.1", "0.25", "0.5", "1", "2")
LONG_STEP = 0.1  # [s]
BEHIND = "Not here: the operator is behind the link. time and pushes go over Bifrost, which is not carried."
NOT_HERE = "In a simulation only: here the robot's time is everybody's, and who pushes it is there."
_TIMEOUT = 2.0  # of a request [s]


class Simulation:
    """Its controls, and what they do; on hardware they are grey."""

    def __init__(self, parts: Parts, context: Context, worker: Worker) -> None:
        self._desk, self._heard, self._body = parts.desk, parts.heard, parts.scene.body
        self._worker, self._node = worker, context.node
        self._period = context.robot.control_period
        linked = behind(context.settings)
        self._here = context.settings.variant == "simulation" and not linked
        self._clock = CLOCK.subscriber(context.node)
        gui = parts.server.gui
        self._told = gui.add_markdown("" if self._here else BEHIND if linked else NOT_HERE)
        with gui.add_folder("Simulated time"):
            self._add_time(gui)
        with gui.add_folder("Push"):
            self._add_pushes(gui)
        if self._here:
            parts.server.scene.on_click()(parts.desk.taking(self._clicked))  # type: ignore[arg-type]  # coroutines, too

    def draw(self) -> None:
        """Say how time passes."""
        received = self._clock.latest()
        if not self._here or received is None:
            return
        clock = received.message
        how = "**paused**" if clock.mode == PAUSED else f"{clock.mode}, {clock.real_time_factor:.2f} × real time"
        text = f"{clock.time * 1e-9:.3f} s, {how}"
        if self._told.content != text:
            self._told.content = text

    def _add_time(self, gui: Any) -> None:
        long = round(LONG_STEP / self._period)
        for label, wanted, value in (
            ("Pause", "pause", 0.0),
            ("Go on", "resume", 0.0),
            (f"Step {1e3 * self._period:g} ms", "step", 1.0),
            (f"Step {1e3 * long * self._period:g} ms", "step", float(long)),
        ):
            button = gui.add_button(label, disabled=not self._here)
            button.on_click(self._desk.taking(self._worker.doing(label.lower(), self._leading(wanted, value))))
        factor = gui.add_dropdown(
            "times real time", FACTORS, initial_value="1", disabled=not self._here, hint="slow motion"
        )
        button = gui.add_button("Set it", disabled=not self._here)

        def slow(visit: Visit) -> None:
            value = float(factor.value)
            self._worker.do(visit, f"{value:g} × real time", self._leading("factor", value))

        button.on_click(self._desk.taking(slow))

    def _add_pushes(self, gui: Any) -> None:
        model = self._body.model.mj
        # The chest first; nothing twice, or the browser's list fails.
        names = dict.fromkeys(
            (self._body.model.robot.tables.chest, *(model.body(b).name for b in range(1, model.nbody)))
        )
        self._which = gui.add_dropdown("body", tuple(names), disabled=not self._here)
        strength = gui.add_slider("impulse [N·s]", 1.0, STRONGEST, 1.0, 15.0, disabled=not self._here)
        self._armed = gui.add_checkbox(
            "click on the robot to push it", False, disabled=not self._here, hint="the body, level, away from you"
        )
        self._strength = strength
        for label, direction in PUSHES.items():
            button = gui.add_button(f"Push {label}", disabled=not self._here)
            button.on_click(self._desk.taking(self._pushing(direction)))
        numbers = gui.add_vector3("forward, left, up [N·s]", (0.0, 0.0, 0.0), step=0.5, disabled=not self._here)
        by_numbers = gui.add_button("Push by these numbers", disabled=not self._here)
        by_numbers.on_click(self._desk.taking(lambda visit: self._push(visit, self._ahead(numbers.value))))

    def _leading(self, wanted: str, value: float) -> Callable[[], str]:
        def lead() -> str:
            reply = SIMULATED_TIME.client(self._node).call(TimeRequest(wanted, value), timeout=_TIMEOUT)
            if not reply.accepted:
                raise RefusalError("time", reply.reason)
            return f"{'stands' if reply.paused else 'passes'} at {reply.time * 1e-9:.3f} s"

        return lead

    def _ahead(self, impulse: Any) -> FloatArray:
        """From the robot's axes to odom's."""
        yaw = self._heard.pelvis.yaw
        c, s = math.cos(yaw), math.sin(yaw)
        x, y, z = (float(each) for each in impulse)
        return np.array((c * x - s * y, s * x + c * y, z))

    def _pushing(self, direction: tuple[float, float]) -> Callable[[Visit], None]:
        def push(visit: Visit) -> None:
            impulse = float(self._strength.value)
            self._push(visit, self._ahead((impulse * direction[0], impulse * direction[1], 0.0)))

        return push

    def _clicked(self, visit: Visit) -> None:
        if not self._armed.value:
            return
        self._desk.lease.require(visit.viewer)
        event = visit.event
        body = hit(self._body, np.array(event.ray_origin), np.array(event.ray_direction))
        if body is None:
            return
        away = np.array((*event.ray_direction[:2], 0.0))
        if (length := float(np.linalg.norm(away))) < 1e-3:
            raise RefusalError("push", "a push is level: look at the robot from the side")
        self._push(visit, float(self._strength.value) * away / length, body)

    def _push(self, visit: Visit, impulse: FloatArray, body: str | None = None) -> None:
        """By an impulse (3,) in odom [N·s]; where the simulated world is turned against it by drift, so is the push."""
        chosen = str(self._which.value) if body is None else body
        request = PushRequest(impulse, DURATION, chosen)

        def push() -> str:
            reply = PUSH.client(self._node).call(request, timeout=_TIMEOUT)
            if not reply.accepted:
                raise RefusalError("push", reply.reason)
            return "pushed"

        self._worker.do(visit, f"push of {float(np.linalg.norm(impulse)):.3g} N·s at {chosen}", push)


def hit(body: Body, origin: FloatArray, direction: FloatArray) -> str | None:
    """The robot's body that a ray meets first; None: it passes by.

    Args:
        body: the robot.
        origin: (3,) in odom [m].
        direction: (3,).
    """
    geom = np.full(1, -1, np.int32)
    model = body.model.mj
    groups = np.array((1, 1, 1, 0, 0, 0), np.uint8)  # what is seen
    mujoco.mj_ray(model, body.data, origin, direction / np.linalg.norm(direction), groups, 0, -1, geom)
    return None if geom[0] < 0 else str(model.body(model.geom_bodyid[geom[0]]).name)
