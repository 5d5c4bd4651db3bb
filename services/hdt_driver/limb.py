"""One arm or hand: checks commands, bounds set-points, and stores the measured state."""

import logging
import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.devices.hdt_bus import Fault
from valor.robot.description import RobotDescription

SILENCE = 0.25  # timeout of commands, after which the limb holds its last set-points [s]
ENGAGE = 0.15  # largest distance of a joint from the set-point that engages it [rad]
JUMP = 0.25  # smallest change between two states that is an encoder fault [rad]
# As numbers, which NumPy keeps in the type of its arrays.
_NO_ANSWER, _ENCODER = int(Fault.NO_ANSWER), int(Fault.ENCODER)
_DISENGAGING = _NO_ANSWER | _ENCODER
_SPEED_MARGIN = 1.5  # set-point speed per velocity limit
_LOG_EVERY = 5.0  # per kind of rejection [s]
_HIGHEST_MODE = 3

_log = logging.getLogger("hdt_driver")


@dataclass(frozen=True)
class Setpoints:
    """Set-points of a limb's joints, (k,) each, in the units of ``HdtCommand``."""

    sequence: int  # of the ``HdtCommand``
    mode: npt.NDArray[np.uint8]
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    stiffness: FloatArray
    damping: FloatArray


class Limb:
    """Joints of a limb, their latest states, and their set-points.

    A joint *engages* on the first set-point near its position. Before that, and again after its modules or the commands
    timed out, it holds its position. The set-point of an engaged joint moves at a bounded speed.
    """

    def __init__(self, robot: RobotDescription, name: str, period: float) -> None:
        """``period``: between two calls of ``setpoints`` [s]."""
        self.name = name  # of its group in robot.yaml
        self.joints = tuple(robot.tables.groups[name])
        indices = robot.group_indices(name)
        self._lower, self._upper = robot.lower[indices], robot.upper[indices]
        self._effort_limit = robot.effort_limit[indices]
        self._velocity_limit = robot.velocity_limit[indices]
        self._step = _SPEED_MARGIN * self._velocity_limit * period
        k = len(self.joints)
        # Latest measurements [rad, rad/s, N·m].
        self.position, self.velocity, self.effort = np.full(k, math.nan), np.zeros(k), np.zeros(k)
        self.temperature = np.full(k, math.nan)  # [°C]
        self.fault = np.full(k, _NO_ANSWER, dtype=np.uint8)  # ``Fault`` bits
        self.voltage = math.nan  # of its supply [V]
        self.applied = 0  # sequence of the latest command applied before those measurements; 0 before the first
        self.rejected = 0  # number of commands
        self._target: Setpoints | None = None  # the latest valid one
        self._received = -math.inf  # [monotonic s]
        self._engaged = np.zeros(k, dtype=bool)
        self._held, self._held_effort = np.zeros(k), np.zeros(k)  # set-points of the last cycle
        self._logged: dict[str, float] = {}

    @property
    def engaged(self) -> bool:
        return bool(self._engaged.all())

    def accept(self, command: Setpoints, now: float) -> None:
        """Store a command received at ``now`` [monotonic s]; an invalid one is rejected whole, counted and logged."""
        if reason := self._fault(command):
            self._reject(reason, now)
            return
        self._target, self._received = command, now

    def measured(self, state: np.void) -> None:
        """Store a state of its modules (``hdt_bus.state_layout``).

        A position that changes faster than a joint can move is an encoder fault: the earlier position stays until the
        encoder reports it again. After a timeout, any position is accepted.
        """
        self.applied, self.voltage = int(state["sequence"]), float(state["voltage"])
        position = state["position"]
        back = self.fault & _NO_ANSWER > 0
        jumped = ~back & (np.abs(position - self.position) > JUMP)
        self.position = np.where(jumped, self.position, position)
        self.velocity = np.where(jumped, 0.0, state["velocity"])
        self.effort, self.temperature = state["effort"], state["temperature"]
        self.fault = state["fault"] | np.where(jumped, np.uint8(_ENCODER), np.uint8(0))
        self._engaged &= ~back & (self.fault & _DISENGAGING == 0)
        self._held = np.where(back, position, self._held)  # it may have moved during the timeout
        self._held_effort = np.where(back, 0.0, self._held_effort)

    def timed_out(self) -> None:
        """Mark all joints: the modules no longer respond."""
        self.fault = self.fault | np.uint8(_NO_ANSWER)
        self.velocity, self.effort = np.zeros(len(self.joints)), np.zeros(len(self.joints))
        self._engaged[:] = False

    def setpoints(self, now: float) -> Setpoints | None:
        """Set-points of this cycle at ``now`` [monotonic s]; None without a command or a measured position."""
        target = self._target
        if target is None or np.isnan(self.position).any():
            return None
        if now - self._received > SILENCE:
            self._target = None
            self._engaged[:] = False
            _log.warning("%s: no command for %g s; it holds its position", self.name, SILENCE)
        position = np.minimum(np.maximum(target.position, self._lower), self._upper)
        if self._target is not None:
            self._engage(position, now)
        step = np.minimum(np.maximum(position - self._held, -self._step), self._step)
        velocity = np.minimum(np.maximum(target.velocity, -self._velocity_limit), self._velocity_limit)
        engaged = self._engaged
        self._held = np.where(engaged, self._held + step, self._held)
        self._held_effort = np.where(engaged, target.effort, self._held_effort)
        velocity = np.where(engaged, velocity, 0.0)
        effort = np.minimum(np.maximum(self._held_effort, -self._effort_limit), self._effort_limit)
        return replace(target, position=self._held, velocity=velocity, effort=effort)

    def _engage(self, position: FloatArray, now: float) -> None:
        waiting = ~self._engaged & (self.fault & _DISENGAGING == 0)
        if not waiting.any():
            return
        error = np.abs(position - self.position)
        near = waiting & (error <= ENGAGE)
        self._held[near] = position[near]
        self._engaged |= near
        if (far := waiting & ~near).any():
            worst = int(np.argmax(np.where(far, error, 0.0)))
            self._reject(
                f"{self.joints[worst]}: the first set-point is {error[worst]:.2f} rad from the joint's position, "
                f"expected at most {ENGAGE:g} rad",
                now,
            )

    def _fault(self, command: Setpoints) -> str:
        k = len(self.joints)
        numbers = (command.position, command.velocity, command.effort, command.stiffness, command.damping)
        if command.mode.size != k or any(each.size != k for each in numbers):
            sizes = ", ".join(str(each.size) for each in (command.mode, *numbers))
            return f"wrong length: {sizes} (mode, position, velocity, effort, stiffness, damping), expected {k}"
        if not math.isfinite(sum(float(each.dot(each)) for each in numbers)):
            return "not finite: position, velocity, effort, stiffness or damping"
        if command.mode.max() > _HIGHEST_MODE:
            return f"unknown mode: {command.mode.max()}, expected 0 to {_HIGHEST_MODE}"
        if command.stiffness.min() < 0.0 or command.damping.min() < 0.0:
            return "negative gain: stiffness or damping"
        return ""

    def _reject(self, reason: str, now: float) -> None:
        self.rejected += 1
        kind = reason.partition(":")[0]
        if now - self._logged.get(kind, -math.inf) >= _LOG_EVERY:
            self._logged[kind] = now
            _log.warning("%s: command rejected: %s", self.name, reason)
