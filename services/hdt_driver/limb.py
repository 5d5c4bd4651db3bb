"""One arm or hand: which set-points its modules get, whatever is asked of it."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

import numpy as np

from valor.common.arrays import FloatArray
from valor.devices.hdt_bus import Fault, SegmentState, Setpoints, segments
from valor.robot.description import RobotDescription

SILENCE = 0.25  # without a command for so long, the limb stops where it was told to be last [s]
ENGAGE = 0.15  # a joint that is not led yet takes no set-point farther off than this [rad]
JUMP = 0.25  # between two states of a joint, that it cannot have moved by [rad]
# As numbers, which NumPy keeps in the type of its arrays.
_NO_ANSWER, _ENCODER = int(Fault.NO_ANSWER), int(Fault.ENCODER)
_UNLED = _NO_ANSWER | _ENCODER  # a joint that has them is not led
_SPEED_MARGIN = 1.5  # over a joint's velocity limit, that its set-point may move with
_LOG_EVERY = 5.0  # of each kind of refusal [s]
_HIGHEST_MODE = 3

_log = logging.getLogger("hdt_driver")


@dataclass(frozen=True)
class Command:
    """A command as it came; (k,) each if it is sound.

    Attributes:
        sequence: the sender's.
        setpoints: what is asked of the joints.
    """

    sequence: int
    setpoints: Setpoints


class Limb:
    """A limb's joints, what is known of them and what they are told.

    A joint is *led* once a set-point came that is near where it is. Until then, and again after its modules or its
    commands were silent, it holds where it is. A led joint's set-point moves no quicker than its limit allows.

    Attributes:
        name: its group in robot.yaml.
        joints: their names, k of them.
        parts: which of them each of its segments has.
        position, velocity, effort, temperature: (k,) measured last [rad, rad/s, N·m, °C].
        fault: (k,) ``Fault`` bits.
        voltage: of its supply [V].
        obeyed: sequence of the newest command that acted before all of that was measured; 0: none yet.
        refused: commands that were not sound.
    """

    def __init__(self, robot: RobotDescription, name: str, period: float) -> None:
        """``period``: between two calls of ``setpoints`` [s]."""
        self.name = name
        self.joints = tuple(robot.tables.groups[name])
        self.parts = segments(len(self.joints))
        places = robot.group_indices(name)
        self._lower, self._upper = robot.lower[places], robot.upper[places]
        self._effort_limit = robot.effort_limit[places]
        self._velocity_limit = robot.velocity_limit[places]
        self._step = _SPEED_MARGIN * self._velocity_limit * period
        k = len(self.joints)
        self.position, self.velocity, self.effort = np.full(k, math.nan), np.zeros(k), np.zeros(k)
        self.temperature = np.full(k, math.nan)
        self.fault = np.full(k, _NO_ANSWER, dtype=np.uint8)
        self.voltage = math.nan
        self.obeyed = 0
        self.refused = 0
        self._target: Command | None = None  # the newest sound one
        self._heard = -math.inf
        self._led = np.zeros(k, dtype=bool)
        self._held = np.zeros(k)  # set-points of the last cycle
        self._effort = np.zeros(k)
        self._sent: dict[int, int] = {}  # count of a frame → sequence of the command that it carried
        self._logged: dict[str, float] = {}

    @property
    def known(self) -> bool:
        """Whether every joint has been measured: nothing is told to a limb of which anything is unknown."""
        return not np.isnan(self.position).any()

    @property
    def led(self) -> bool:
        """Whether all joints follow commands."""
        return bool(self._led.all())

    def take(self, command: Command, now: float) -> None:
        """A command came [monotonic s]; refused whole, counted and logged if it is not sound."""
        if reason := self._fault(command.setpoints):
            self._refuse(reason, now)
            return
        self._target, self._heard = command, now

    def measured(self, part: slice, state: SegmentState) -> None:
        """A segment answered."""
        if state.command_sequence in self._sent:
            self.obeyed = self._sent[state.command_sequence]
        self.voltage = state.voltage
        # As nearly always: all is well and was, and nothing has jumped.
        if not (self.fault.any() or state.fault.any()) and (np.abs(state.position - self.position[part]).max() <= JUMP):
            self.position[part], self.velocity[part] = state.position, state.velocity
            self.effort[part], self.temperature[part] = state.effort, state.temperature
            return
        back = self.fault[part] & _NO_ANSWER > 0
        # What moves farther between two states than it can is an encoder's mistake: where it was is believed, until it
        # says that again. After a silence anything may be true.
        jumped = ~back & (np.abs(state.position - self.position[part]) > JUMP)
        self.position[part] = np.where(jumped, self.position[part], state.position)
        self.velocity[part] = np.where(jumped, 0.0, state.velocity)
        self.effort[part], self.temperature[part] = state.effort, state.temperature
        self.fault[part] = state.fault | jumped.astype(np.uint8) * _ENCODER
        self._led[part] &= ~back & (self.fault[part] & _UNLED == 0)
        if back.any():  # where it is now, it may have come by itself
            self._held[part] = np.where(back, state.position, self._held[part])
            self._effort[part] = np.where(back, 0.0, self._effort[part])

    def silent(self, part: slice) -> None:
        """A segment does not answer any more."""
        self.fault[part] |= _NO_ANSWER
        self.velocity[part] = self.effort[part] = 0.0
        self._led[part] = False

    def setpoints(self, frame: int, now: float) -> Setpoints | None:
        """What the modules are told in this cycle; None: nothing new, before anybody has led them.

        Args:
            frame: count of the frames that carry it, 1 to 65535.
            now: monotonic [s].
        """
        target = self._target
        if target is None or not self.known:
            return None
        wanted = target.setpoints
        if now - self._heard > SILENCE:  # whoever comes next begins from where the limb is
            self._target = None
            self._led[:] = False
            _log.warning("%s: no command for %g s; it stays where it is", self.name, SILENCE)
        position = np.minimum(np.maximum(wanted.position, self._lower), self._upper)
        if not self._led.all():
            self._lead(position, now)
        step = np.minimum(np.maximum(position - self._held, -self._step), self._step)
        velocity = np.minimum(np.maximum(wanted.velocity, -self._velocity_limit), self._velocity_limit)
        if (led := self._led).all():
            self._held, self._effort = self._held + step, wanted.effort.copy()
        else:
            self._held = np.where(led, self._held + step, self._held)
            self._effort = np.where(led, wanted.effort, self._effort)
            velocity = np.where(led, velocity, 0.0)
        effort = np.minimum(np.maximum(self._effort, -self._effort_limit), self._effort_limit)
        self._sent[frame] = target.sequence
        if len(self._sent) > 64:
            del self._sent[next(iter(self._sent))]
        return Setpoints(wanted.mode, self._held, velocity, effort, wanted.stiffness, wanted.damping)

    def _lead(self, position: FloatArray, now: float) -> None:
        """Joints that are not led yet and whose set-point is near are led from now on."""
        if self._target is None:
            return
        waiting = ~self._led & (self.fault & _UNLED == 0)
        error = np.abs(position - self.position)
        near = waiting & (error <= ENGAGE)
        self._held[near] = position[near]
        self._led |= near
        if (far := waiting & ~near).any():
            worst = int(np.argmax(np.where(far, error, 0.0)))
            self._refuse(
                f"{self.joints[worst]}: the first set-point is {error[worst]:.2f} rad from where the joint is, "
                f"at most {ENGAGE:g} rad is taken",
                now,
            )

    def _fault(self, wanted: Setpoints) -> str:
        k = len(self.joints)
        numbers = (wanted.position, wanted.velocity, wanted.effort, wanted.stiffness, wanted.damping)
        if wanted.mode.size != k or any(each.size != k for each in numbers):
            sizes = ", ".join(str(each.size) for each in (wanted.mode, *numbers))
            return f"wrong length: {sizes} (mode, position, velocity, effort, stiffness, damping), expected {k}"
        if not math.isfinite(sum(float(each.dot(each)) for each in numbers)):
            return "not finite: position, velocity, effort, stiffness or damping"
        if wanted.mode.max() > _HIGHEST_MODE:
            return f"unknown mode: {wanted.mode.max()}, expected 0 to {_HIGHEST_MODE}"
        if wanted.stiffness.min() < 0.0 or wanted.damping.min() < 0.0:
            return "negative gain: stiffness or damping"
        return ""

    def _refuse(self, reason: str, now: float) -> None:
        self.refused += 1
        kind = reason.partition(":")[0]
        if now - self._logged.get(kind, -math.inf) >= _LOG_EVERY:
            self._logged[kind] = now
            _log.warning("%s: command not obeyed: %s", self.name, reason)
