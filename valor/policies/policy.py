"""A policy on a robot: targets of its joints out of what the robot senses."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.policies.contract import Contract
from valor.policies.observations import Moment, Observer, Senses
from valor.robot.description import RobotDescription

_STANDING = 0.01  # velocity commands below it are none [m/s], [rad/s]


@dataclass(slots=True)
class Targets:
    """Targets of the policy's m joints, in its order; None: the policy gives none."""

    position: FloatArray  # (m,) [rad]
    stiffness: FloatArray  # (m,) [N·m/rad]
    damping: FloatArray  # (m,) [N·m·s/rad]
    velocity: FloatArray | None = None  # (m,) [rad/s]
    effort: FloatArray | None = None  # (m,) [N·m]


class Policy:
    """A contract at work; ``indices`` (m,) are its joints in ``RobotDescription.joints``."""

    def __init__(self, contract: Contract, robot: RobotDescription) -> None:
        """Start as after ``reset``; the contract is one for this robot."""
        self.contract = contract
        self.indices: npt.NDArray[np.intp] = np.array([robot.index[name] for name in contract.joints], np.intp)
        newest_first, zeros = contract.history_order == "newest_first", contract.history_start == "zeros"
        self._observer = Observer(contract.observation, newest_first=newest_first, zeros=zeros)
        gait = contract.gait
        self._offsets = np.array([0.0] if gait is None else gait["offsets"])
        self._standing: float | None = None if gait is None else gait.get("standing")
        self._advance = 0.0 if gait is None else 2.0 * math.pi * contract.period / gait["period"]
        self.reset()

    def reset(self) -> None:
        """Forget past observations, the last action, phases and the state of recurrent networks."""
        contract = self.contract
        self._observer.reset()
        self._action = np.zeros(len(contract.joints))
        self._phase, self._held = self._offsets, False
        self._values: dict[str, FloatArray] = dict(contract.constants)
        for name in contract.feedback:
            self._values[name] = contract.initial.get(name, np.zeros(contract.model.inputs[name].size))

    def act(self, senses: Senses) -> Targets:
        """Compute the targets of the next period. Call it once a period; targets are NaN if the model's outputs are."""
        contract = self.contract
        command = np.clip(senses.velocity_command, *contract.command_ranges)
        if self._standing is not None:  # phases start from their offsets with a walk
            standing = math.hypot(command[0], command[1]) < _STANDING and abs(command[2]) < _STANDING
            if standing or self._held:
                self._phase = np.full(len(self._offsets), self._standing) if standing else self._offsets
            self._held = standing
        moment = Moment(senses, command, self._action, self._phase)
        found = contract.model.run({**self._values, **self._observer.inputs(moment)})
        self._values |= {name: found[output] for name, output in contract.feedback.items()}
        self._phase = (self._phase + self._advance + math.pi) % (2.0 * math.pi) - math.pi
        given = {role: found[name].astype(float)[order] for role, (name, order) in contract.outputs.items()}
        if (action := given.get("action")) is not None:
            self._action = np.clip(action, *contract.action_clip)
            given["position"] = contract.action_offset + contract.action_scale * self._action
        return Targets(
            np.clip(given["position"], *contract.position_clip),
            given.get("stiffness", contract.stiffness),
            given.get("damping", contract.damping),
            given.get("velocity"),
            given.get("effort"),
        )
