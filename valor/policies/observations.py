"""Terms of observations: one function for each, and their samples in vectors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.rotation import quaternion, vertical


@dataclass(slots=True)
class Senses:
    """What a policy may know; vectors over joints are in the order of ``RobotDescription.joints``."""

    joint_position: FloatArray  # (n,) [rad]
    joint_velocity: FloatArray  # (n,) [rad/s]
    pelvis_orientation: FloatArray  # (4,) w, x, y, z in odom
    pelvis_angular_velocity: FloatArray  # (3,) in pelvis [rad/s]
    pelvis_linear_velocity: FloatArray  # (3,) in pelvis [m/s]
    velocity_command: FloatArray  # (3,) forward, left [m/s], turning left [rad/s]


@dataclass(slots=True)
class Moment:
    """What terms are computed from."""

    senses: Senses
    command: FloatArray  # (3,) within the policy's ranges
    last_action: FloatArray  # zeros before the first
    phase: FloatArray  # of each foot [rad]


@dataclass(frozen=True)
class Term:
    """A term bound to a robot."""

    name: str  # in ``TERMS``
    input: str  # of the model
    size: int  # of a sample
    scale: FloatArray  # (size,), or (1,)
    offset: FloatArray  # likewise, after the scale
    clip: tuple[float, float] | None  # before the scale
    history: int  # samples
    index: npt.NDArray[np.intp]  # of its joints in the robot's
    zero: FloatArray  # default positions of its joints [rad]
    value: FloatArray  # of a constant
    quaternion_order: str

    def sample(self, moment: Moment) -> FloatArray:
        """Return its (size,) present value: clipped × scale + offset."""
        value = TERMS[self.name][1](moment, self)
        return (value if self.clip is None else np.clip(value, *self.clip)) * self.scale + self.offset


def _orientation(moment: Moment, term: Term) -> FloatArray:
    return np.roll(moment.senses.pelvis_orientation, -1 if term.quaternion_order == "xyzw" else 0)


def _gravity(moment: Moment, _: Term) -> FloatArray:
    return -np.array(vertical(quaternion(moment.senses.pelvis_orientation)))


def _clock(moment: Moment, _: Term) -> FloatArray:
    return np.array([np.sin(moment.phase[0]), np.cos(moment.phase[0])])


Size = int | Literal["joints", "action", "feet", "value"]
TERMS: dict[str, tuple[Size, Callable[[Moment, Term], FloatArray]]] = {
    "base_angular_velocity": (3, lambda moment, _: moment.senses.pelvis_angular_velocity),  # in pelvis [rad/s]
    "base_linear_velocity": (3, lambda moment, _: moment.senses.pelvis_linear_velocity),  # in pelvis [m/s]
    "projected_gravity": (3, _gravity),  # direction in pelvis: 0, 0, -1 upright
    "base_orientation": (4, _orientation),  # of pelvis in odom, in the policy's order of quaternions
    "velocity_command": (3, lambda moment, _: moment.command),  # forward, left [m/s], turning left [rad/s]
    "linear_velocity_command": (2, lambda moment, _: moment.command[:2]),
    "yaw_rate_command": (1, lambda moment, _: moment.command[2:]),
    "joint_position": ("joints", lambda moment, term: moment.senses.joint_position[term.index]),  # [rad]
    "joint_position_relative": ("joints", lambda moment, term: moment.senses.joint_position[term.index] - term.zero),
    "joint_velocity": ("joints", lambda moment, term: moment.senses.joint_velocity[term.index]),  # [rad/s]
    "last_action": ("action", lambda moment, _: moment.last_action),
    "gait_sin": ("feet", lambda moment, _: np.sin(moment.phase)),
    "gait_cos": ("feet", lambda moment, _: np.cos(moment.phase)),
    "gait_clock": (2, _clock),  # sine and cosine of the first phase
    "constant": ("value", lambda _, term: term.value),  # numbers of the sidecar
}


class Observer:
    """The model's inputs out of the present moment and of those before; each term has its own history."""

    def __init__(self, terms: Sequence[Term], *, newest_first: bool, zeros: bool) -> None:
        """Start without history; ``zeros``: before the first sample are zeros, instead of its repetition."""
        self._terms, self._newest_first, self._zeros = terms, newest_first, zeros
        self._samples: list[FloatArray] = []  # (history, size) of each term, the oldest first

    def reset(self) -> None:
        """Forget all samples."""
        self._samples = []

    def inputs(self, moment: Moment) -> Mapping[str, FloatArray]:
        """Add a moment, and return the vector of each of the model's inputs."""
        present = [term.sample(moment) for term in self._terms]
        if not self._samples:
            fill = 0.0 if self._zeros else 1.0
            self._samples = [
                np.tile(fill * value, (term.history, 1)) for value, term in zip(present, self._terms, strict=True)
            ]
        parts: dict[str, list[FloatArray]] = {}
        for term, value, samples in zip(self._terms, present, self._samples, strict=True):
            samples[:-1] = samples[1:]
            samples[-1] = value
            parts.setdefault(term.input, []).append((samples[::-1] if self._newest_first else samples).ravel())
        return {name: np.concatenate(values) for name, values in parts.items()}
